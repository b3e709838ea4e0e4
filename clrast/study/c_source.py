"""Structs, types and functions of a kernel program, found in the tokens that the preprocessor leaves."""

from __future__ import annotations

import re
from dataclasses import dataclass

Token = str

FLOAT = re.compile(r"(float|double|half)\d*(_v)?")
INTEGER = re.compile(r"(bool|u?char|u?short|u?int|u?long|unsigned|size_t|void)\d*(_v)?")
QUALIFIERS = {"const", "global", "local", "private", "constant", "restrict", "static", "inline", "volatile"}


def is_float(kind: str) -> bool:
    """Whether a basic type is one of floats, or of vectors of them."""
    return FLOAT.fullmatch(kind) is not None


@dataclass
class Function:
    """`kind` : of what it returns. parameters : name -> type as written. body : tokens between its braces."""

    kind: str
    parameters: dict[str, str]
    body: list[Token]


class Source:
    """A preprocessed program: structs by name (field -> type as written) and functions by name."""

    def __init__(self, tokens: list[Token]) -> None:
        self.structs: dict[str, dict[str, str]] = {}
        self.functions: dict[str, Function] = {}
        self._types: dict[str, str] = {}
        self._scan(tokens)

    def kind_of_type(self, name: str) -> str:
        """A basic type or the name of a struct, typedefs resolved; KeyError for what is no type."""
        name = self._types.get(name, name)
        if FLOAT.fullmatch(name) or INTEGER.fullmatch(name) or name in self.structs:
            return name
        raise KeyError(name)

    def is_type(self, name: str) -> bool:
        try:
            self.kind_of_type(name)
        except KeyError:
            return False
        return True

    def _scan(self, tokens: list[Token]) -> None:
        """Take in every struct, typedef and function of the program."""
        at = 0
        while at < len(tokens):
            if tokens[at] == "typedef" and tokens[at + 1] == "struct":
                opened = tokens.index("{", at)
                closed = matching(tokens, opened)
                end = tokens.index(";", closed)
                name = next(t for t in tokens[closed + 1 : end] if t.isidentifier() and not t.startswith("__"))
                self.structs[name] = self._fields(tokens[opened + 1 : closed])
                at = end + 1
            elif tokens[at] == "typedef":
                end = tokens.index(";", at)
                self._types[tokens[end - 1]] = self._types.get(tokens[end - 2], tokens[end - 2])
                at = end + 1
            elif tokens[at] == "{":
                closed = matching(tokens, at)
                self._add_function(tokens, at, closed)
                at = closed + 1
            else:
                at += 1

    def _fields(self, tokens: list[Token]) -> dict[str, str]:
        fields: dict[str, str] = {}
        for declaration in split(tokens, ";"):
            words = [t for t in declaration if t not in QUALIFIERS]
            for member in split(words[1:], ","):
                fields[next(t for t in member if t.isidentifier())] = words[0]
        return fields

    def _add_function(self, tokens: list[Token], opened: int, closed: int) -> None:
        if tokens[opened - 1] != ")":
            return
        start = opened - 1
        depth = 1
        while depth:
            start -= 1
            depth += (tokens[start] == ")") - (tokens[start] == "(")
        parameters = {}
        for parameter in split(tokens[start + 1 : opened - 1], ","):
            words = [t for t in parameter if t.isidentifier() and t not in QUALIFIERS]
            if len(words) > 1:
                parameters[words[1]] = words[0]
        self.functions[tokens[start - 1]] = Function(tokens[start - 2], parameters, tokens[opened + 1 : closed])


def matching(tokens: list[Token], opened: int) -> int:
    """Index of the bracket that closes the one at `opened`."""
    pairs = {"(": ")", "{": "}", "[": "]"}
    left, right, depth = tokens[opened], pairs[tokens[opened]], 0
    for at in range(opened, len(tokens)):
        depth += (tokens[at] == left) - (tokens[at] == right)
        if depth == 0:
            return at
    raise ValueError(f"a bracket {left} is not closed")


def split(tokens: list[Token], separator: str) -> list[list[Token]]:
    """Runs between separators that stand in no bracket; empty ones are left out."""
    runs: list[list[Token]] = [[]]
    depth = 0
    for token in tokens:
        depth += (token in "([{") - (token in ")]}")
        if token == separator and depth == 0:
            runs.append([])
        else:
            runs[-1].append(token)
    return [run for run in runs if run]
