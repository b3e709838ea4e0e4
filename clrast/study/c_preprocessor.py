"""As much of the C preprocessor as our kernels use: comments, conditionals, macros with and without arguments."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

TOKEN = re.compile(
    r"[A-Za-z_]\w*|0[xX][0-9a-fA-F]+[uUlL]*|(?:\d+\.\d*|\.\d+|\d+)(?:[eE][+-]?\d+)?[fFuUlL]*"
    r"|<<=|>>=|->|\+\+|--|<<|>>|<=|>=|==|!=|&&|\|\||[-+*/&|^%]=|\S"
)
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_DIRECTIVE = re.compile(r"\s*#\s*(\w+)\s*(.*)", re.DOTALL)
_DEFINE = re.compile(r"(\w+)(\(([^)]*)\))?\s*(.*)", re.DOTALL)


@dataclass(frozen=True)
class Macro:
    """`parameters` : None where it takes none."""

    parameters: tuple[str, ...] | None
    body: tuple[str, ...]


def preprocess(text: str, defined: Mapping[str, str]) -> list[str]:
    """The tokens that a compiler would see. defined : name -> value of build options."""
    macros = {name: Macro(None, tuple(TOKEN.findall(value))) for name, value in defined.items()}
    tokens: list[str] = []
    open_branches: list[tuple[bool, bool]] = []  # whether this branch is read, whether one was read before it
    for line in _COMMENT.sub(" ", text).replace("\\\n", " ").splitlines():
        reading = all(read for read, _ in open_branches)
        directive = _DIRECTIVE.match(line)
        if directive:
            _obey(directive[1], directive[2], macros, open_branches, reading)
        elif reading:
            tokens += TOKEN.findall(line)
    return expand(tokens, macros)


def _obey(
    name: str, rest: str, macros: dict[str, Macro], open_branches: list[tuple[bool, bool]], reading: bool
) -> None:
    """One directive; those that choose no code (pragma, line) are passed over."""
    if name in ("if", "ifdef", "ifndef"):
        condition = {"if": rest, "ifdef": f"defined({rest})", "ifndef": f"!defined({rest})"}[name]
        read = reading and evaluate(condition, macros)
        open_branches.append((read, read))
    elif name in ("elif", "else"):
        _, before = open_branches.pop()
        outer = all(read for read, _ in open_branches)
        read = outer and not before and (name == "else" or evaluate(rest, macros))
        open_branches.append((read, before or read))
    elif name == "endif":
        open_branches.pop()
    elif name == "define" and reading:
        match = _DEFINE.fullmatch(rest.strip())
        assert match is not None
        parameters = tuple(p.strip() for p in match[3].split(",") if p.strip()) if match[2] else None
        macros[match[1]] = Macro(parameters, tuple(TOKEN.findall(match[4])))
    elif name == "undef" and reading:
        macros.pop(rest.strip(), None)


def evaluate(condition: str, macros: Mapping[str, Macro]) -> bool:
    """An integer condition; names that are no macro are 0."""
    known = re.sub(r"defined\s*\(?\s*(\w+)\s*\)?", lambda name: str(int(name[1] in macros)), condition)
    words = []
    for token in expand(TOKEN.findall(known), macros):
        number = re.fullmatch(r"(0[xX][0-9a-fA-F]+|\d+)[uUlL]*", token)
        if number:
            words.append(str(int(number[1], 0)))
        elif token.isidentifier():
            words.append("0")
        else:
            words.append({"&&": " and ", "||": " or ", "!": " not "}.get(token, token))
    return bool(eval("".join(words), {"__builtins__": {}}))  # digits and operators alone


def expand(tokens: list[str], macros: Mapping[str, Macro], hidden: frozenset[str] = frozenset()) -> list[str]:
    """Tokens with macros replaced, over and over; `hidden` : macros that are being replaced."""
    result: list[str] = []
    at = 0
    while at < len(tokens):
        token = tokens[at]
        at += 1
        macro = macros.get(token) if token not in hidden else None
        if macro is None:
            result.append(token)
        elif macro.parameters is None:
            result += expand(list(macro.body), macros, hidden | {token})
        elif at < len(tokens) and tokens[at] == "(":
            given, at = _arguments(tokens, at)
            values = dict(zip(macro.parameters, given, strict=False))
            body = [part for word in macro.body for part in values.get(word, [word])]
            result += expand(body, macros, hidden | {token})
        else:
            result.append(token)
    return result


def _arguments(tokens: list[str], at: int) -> tuple[list[list[str]], int]:
    """Arguments of the call whose bracket opens at `at`, and the index after it."""
    given: list[list[str]] = [[]]
    depth = 0
    while True:
        token = tokens[at]
        at += 1
        depth += (token in "([{") - (token in ")]}")
        if depth == 0:
            return given, at
        if token == "," and depth == 1:
            given.append([])
        elif depth > 1 or token != "(":
            given[-1].append(token)
