"""The container of a PLY file: its header, and its elements as columns, ASCII or binary of both byte orders.

Nothing in the header is trusted: counts are held against the bytes that follow before anything is
allocated. Good at: whole-array decoding of elements without lists, and of lists of one length.
Bad at: lists of changing length, which are walked row by row.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from clrast.errors import SceneError
from clrast.scene.texture import shorten

MAX_HEADER_BYTES = 1 << 20
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """`kind` : numpy type code without byte order. `count_kind` : of a list's length, "" where it is no list."""

    name: str
    kind: str
    count_kind: str = ""


@dataclass
class Element:
    """What the header says of one kind of row, and its columns once they are read.

    columns : name -> (row_count,) array, or for a list (lengths (row_count,) int64, values one behind the other)
    """

    name: str
    row_count: int
    properties: list[Property] = field(default_factory=list)
    columns: dict[str, np.ndarray] = field(default_factory=dict)
    lists: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def kind(self, name: str) -> str:
        """The type that the header gives a property (an ASCII file's columns are all float64)."""
        return next(p.kind for p in self.properties if p.name == name)


@dataclass
class Header:
    """`order` : "" for ASCII, else numpy's byte order. `body` : offset of the first byte after the header."""

    order: str
    elements: list[Element]
    body: int
    texture: str = ""


def read_columns(data: bytes) -> Header:
    """The header of a PLY file with all columns filled in."""
    header = parse_header(data)
    if header.order:
        _read_binary(data, header)
    else:
        _read_ascii(data, header)
    return header


def parse_header(data: bytes) -> Header:
    """The header of a PLY file, its counts held against the bytes that follow."""
    if not re.match(rb"ply[ \t]*[\r\n]", data):
        raise SceneError("the first line is not 'ply': this is no PLY file, give another or rename it")
    end = re.compile(rb"(?:\r\n|\r|\n)end_header[ \t]*(\r\n|\r|\n|$)").search(data, 0, MAX_HEADER_BYTES)
    if end is None:
        raise SceneError("the header has no 'end_header': the file is cut short, export it again")
    lines = data[: end.start()].decode("utf-8", "replace").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    header = Header("?", [], end.end())
    for number, line in enumerate(lines[1:], start=2):
        _parse_header_line(header, line, number)
    if header.order == "?":
        raise SceneError("the header has no 'format' line: export the file again")
    for element in header.elements:
        _check_claim(element, header, len(data) - header.body)
    return header


def _parse_header_line(header: Header, line: str, number: int) -> None:
    words = line.split()
    where = f'header line {number} "{shorten(line.strip(), 40)}"'
    if not words or words[0] == "obj_info":
        return
    if words[0] == "comment":
        if len(words) > 2 and words[1].lower() == "texturefile":
            header.texture = line.strip().split(None, 2)[2]
    elif words[0] == "format" and len(words) >= 2 and words[1] in _ORDERS:
        header.order = _ORDERS[words[1]]
    elif words[0] == "element" and len(words) == 3 and re.fullmatch(r"[0-9]{1,18}", words[2]):
        header.elements.append(Element(words[1], int(words[2])))
    elif words[0] == "property" and header.elements and len(words) == 3 and words[1] in _TYPES:
        header.elements[-1].properties.append(Property(words[2], _TYPES[words[1]]))
    elif words[0] == "property" and header.elements and len(words) == 5 and words[1] == "list":
        count_kind, kind = _TYPES.get(words[2], ""), _TYPES.get(words[3], "")
        if count_kind[:1] not in ("i", "u") or not kind:
            raise SceneError(f"{where} has an unknown type: use {', '.join(_TYPES)}")
        header.elements[-1].properties.append(Property(words[4], kind, count_kind))
    else:
        raise SceneError(f"{where} is not understood: export the file again")


def _check_claim(element: Element, header: Header, body_bytes: int) -> None:
    """Refuse counts that the file cannot hold, before anything is allocated."""
    names = [p.name for p in element.properties]
    if len(set(names)) != len(names):
        raise SceneError(f"element {shorten(element.name, 40)} has two properties of one name: export the file again")
    if header.order:
        row_bytes = sum(np.dtype(p.count_kind or p.kind).itemsize for p in element.properties)
    else:
        row_bytes = 2 * len(element.properties)  # a digit and what separates it from the next
    if element.row_count * row_bytes > body_bytes + 1:
        raise SceneError(
            f"the header says {element.row_count} rows of {shorten(element.name, 40)}, "
            f"the file has only {body_bytes} bytes after it: it is cut short, export it again"
        )


def _cut_short(element: Element) -> SceneError:
    return SceneError(
        f"it ends amid its {element.row_count} rows of {shorten(element.name, 40)}: it is cut short, export it again"
    )


def _read_ascii(data: bytes, header: Header) -> None:
    """Fill in the columns of an ASCII file: a stream of numbers, whatever its lines."""
    text = data[header.body :]
    try:
        numbers = np.fromstring(text, dtype=np.float64, sep=" ")
    except ValueError:
        numbers = None
    if numbers is None:
        for word in text.split():
            try:
                float(word)
            except ValueError:
                bad = shorten(word.decode("utf-8", "replace"), 40)
                raise SceneError(f'"{bad}" stands where a number is needed: export the file again') from None
        numbers = np.array(text.split(), dtype=np.float64)
    position = 0
    for element in header.elements:
        if not element.properties:
            continue
        position = _read_ascii_element(element, numbers, position)


def _read_ascii_element(element: Element, numbers: np.ndarray, position: int) -> int:
    """Fill in one element's columns from `numbers` at `position`; returns the position after it."""
    rows = element.row_count
    lengths = _first_row_lengths(element, numbers, position) if rows else {}
    width = len(element.properties) + sum(lengths.values())
    end = position + rows * width
    if end <= len(numbers) and _take_table(element, numbers[position:end].reshape(rows, width), lengths):
        return end
    if not any(p.count_kind for p in element.properties):
        raise _cut_short(element)
    return _walk_ascii_rows(element, numbers, position)


def _first_row_lengths(element: Element, numbers: np.ndarray, position: int) -> dict[str, int]:
    """The lengths of the lists of the first row, by name."""
    lengths = {}
    for p in element.properties:
        if p.count_kind:
            if position >= len(numbers):
                raise _cut_short(element)
            lengths[p.name] = _list_length(element, numbers[position])
            position += lengths[p.name]
        position += 1
    return lengths


def _take_table(element: Element, table: np.ndarray, lengths: dict[str, int]) -> bool:
    """Fill in the columns from equal rows; False where the lists' lengths turn out to differ.

    table : (row_count, numbers in a row) float64
    """
    column = 0
    for p in element.properties:
        if p.count_kind:
            length = lengths.get(p.name, 0)
            if (table[:, column] != length).any():
                return False
            values = table[:, column + 1 : column + 1 + length].reshape(-1)
            element.lists[p.name] = (np.full(len(table), length, np.int64), values)
            column += length
        else:
            element.columns[p.name] = table[:, column]
        column += 1
    return True


def _list_length(element: Element, value: float) -> int:
    if not (0 <= value < 1 << 32 and value == int(value)):
        raise SceneError(f"a row of {shorten(element.name, 40)} has a list of {value:g} values: export the file again")
    return int(value)


def _walk_ascii_rows(element: Element, numbers: np.ndarray, position: int) -> int:
    """As `_read_ascii_element`, row by row, for lists whose length changes."""
    found: dict[str, list[int]] = {p.name: [] for p in element.properties}
    lengths: dict[str, list[int]] = {p.name: [] for p in element.properties if p.count_kind}
    stream = numbers.tolist()
    end = len(stream)
    for _ in range(element.row_count):
        for p in element.properties:
            if position >= end:
                raise _cut_short(element)
            found[p.name].append(position)
            if p.count_kind:
                length = _list_length(element, stream[position])
                lengths[p.name].append(length)
                position += length
            position += 1
    if position > end:
        raise _cut_short(element)
    for p in element.properties:
        places = np.array(found[p.name], np.int64)
        if p.count_kind:
            counts = np.array(lengths[p.name], np.int64)
            element.lists[p.name] = (counts, numbers[_spread(places + 1, counts)])
        else:
            element.columns[p.name] = numbers[places]
    return position


def _spread(starts: np.ndarray, counts: np.ndarray, step: int = 1) -> np.ndarray:
    """starts[0], starts[0] + step, ... counts[0] of them, then those of starts[1], and so on."""
    before = np.cumsum(counts) - counts
    within = np.arange(int(counts.sum()), dtype=np.int64) - np.repeat(before, counts)
    return np.repeat(starts, counts) + step * within


def _read_binary(data: bytes, header: Header) -> None:
    """Fill in the columns of a binary file."""
    position = header.body
    for element in header.elements:
        if not element.properties:
            continue
        record = _record_type(element, data, position, header.order)
        end = position + element.row_count * record.itemsize
        if end <= len(data):
            rows = np.frombuffer(data, record, element.row_count, position)
            if _take_records(element, rows):
                position = end
                continue
        if not any(p.count_kind for p in element.properties):
            raise _cut_short(element)
        position = _walk_binary_rows(element, data, position, header.order)


def _record_type(element: Element, data: bytes, position: int, order: str) -> np.dtype:
    """The type of a row, if all lists have the lengths that those of the first row have."""
    members: list[tuple] = []
    for number, p in enumerate(element.properties):
        length: tuple[int, ...] = ()
        if p.count_kind:
            count = np.dtype(order + p.count_kind)
            if element.row_count and position + count.itemsize > len(data):
                raise _cut_short(element)
            first = int(np.frombuffer(data, count, 1, position)[0]) if element.row_count else 0
            if first < 0 or position + first > len(data):
                raise _cut_short(element)
            members.append((f"count{number}", count))
            position += count.itemsize
            length = (first,)
        members.append((f"value{number}", np.dtype(order + p.kind), length))
        position += np.dtype(p.kind).itemsize * (length[0] if length else 1)
    return np.dtype(members)


def _take_records(element: Element, rows: np.ndarray) -> bool:
    """Fill in the columns from equal rows; False where the lists' lengths turn out to differ."""
    for number, p in enumerate(element.properties):
        values = rows[f"value{number}"]
        if not p.count_kind:
            element.columns[p.name] = values
            continue
        counts = rows[f"count{number}"].astype(np.int64)
        if len(counts) and (counts != values.shape[1]).any():
            return False
        element.lists[p.name] = (counts, values.reshape(-1))
    return True


def _walk_binary_rows(element: Element, data: bytes, position: int, order: str) -> int:
    """Fill in the columns row by row, for lists whose length changes; returns the position after them."""
    byte_order = "big" if order == ">" else "little"
    plan = [
        (p, np.dtype(p.kind).itemsize, np.dtype(p.count_kind or "u1").itemsize, p.count_kind.startswith("i"))
        for p in element.properties
    ]
    found: dict[str, list[int]] = {p.name: [] for p in element.properties}
    lengths: dict[str, list[int]] = {p.name: [] for p in element.properties}
    end = len(data)
    for _ in range(element.row_count):
        for p, size, count_size, signed in plan:
            length = 1
            if p.count_kind:
                length = int.from_bytes(data[position : position + count_size], byte_order, signed=signed)  # type: ignore[arg-type]
                position += count_size
            found[p.name].append(position)
            lengths[p.name].append(length)
            position += size * length
            if length < 0 or position > end:
                raise _cut_short(element)
    buffer = np.frombuffer(data, np.uint8)
    for p, size, _, _ in plan:
        counts = np.array(lengths[p.name], np.int64)
        starts = _spread(np.array(found[p.name], np.int64), counts, size)
        values = buffer[starts[:, None] + np.arange(size)].view(np.dtype(order + p.kind)).reshape(-1)
        if p.count_kind:
            element.lists[p.name] = (counts, values)
        else:
            element.columns[p.name] = values
    return position
