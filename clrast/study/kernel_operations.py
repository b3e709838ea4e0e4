"""Scalar operations of a kernel's functions, counted in its source: calls followed, build options resolved.

A lane of a vector counts as one scalar: a triangle in a setup, a sample in a block. Only what our kernels are written
in is understood: declarations, assignments, returns, blocks, `if`, and loops with a constant number of rounds;
anything else is an error, so that nothing is passed over.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import asdict, dataclass, replace
from functools import lru_cache

from clrast.opencl.features import Edges, Features, Precision, Projection
from clrast.opencl.kernels import source_text
from clrast.study.c_preprocessor import preprocess
from clrast.study.c_source import QUALIFIERS, Source, Token, is_float, matching


@dataclass(frozen=True)
class KernelOperations:
    """Of floats: add (and subtract), mul, div, fma, compare, select; other: integers, bits, conversions."""

    add: int = 0
    mul: int = 0
    div: int = 0
    fma: int = 0
    compare: int = 0
    select: int = 0
    other: int = 0

    @property
    def arithmetic(self) -> int:
        """What compares with the paper's scalar operations, none of them fused but fma."""
        return self.add + self.mul + self.div + self.fma

    def as_dict(self) -> dict[str, int]:
        return {**asdict(self), "arithmetic": self.arithmetic}


@lru_cache(maxsize=None)
def count_operations(
    program: str, functions: tuple[str, ...], *, edges: Edges, precision: Precision, projection: Projection
) -> tuple[KernelOperations, ...]:
    """Operations of each of the `functions`, those that they call included. program : a file of cl/."""
    features = replace(Features(), edges=edges, precision=precision, projection=projection)
    defined = dict(option[len("-D "):].split("=") for option in features.defines())
    return count_source(source_text(program), functions, defined)


def count_source(text: str, functions: tuple[str, ...], defined: dict[str, str]) -> tuple[KernelOperations, ...]:
    """The same of a program's text. defined : name -> value of macros."""
    counter = _Counter(Source(preprocess(text, defined)))
    return tuple(KernelOperations(**counter.count(name)) for name in functions)


_NUMBER = re.compile(r"0[xX][0-9a-fA-F]+[uUlL]*|(?:\d+\.\d*|\.\d+|\d+)(?:[eE][+-]?\d+)?[fFuUlL]*")
_PRECEDENCE = {
    "||": 1, "&&": 2, "|": 3, "^": 4, "&": 5, "==": 6, "!=": 6, "<": 7, ">": 7, "<=": 7, ">=": 7,
    "<<": 8, ">>": 8, "+": 9, "-": 9, "*": 10, "/": 10, "%": 10,
}  # fmt: skip
_ASSIGNMENTS = {"=", "+=", "-=", "*=", "/=", "&=", "|=", "^=", "<<=", ">>="}
_KINDS = {"+": "add", "-": "add", "*": "mul", "/": "div"}
_COMPARISONS = {"==", "!=", "<", ">", "<=", ">="}
_BUILTINS = {"min": "compare", "max": "compare", "clamp": "compare", "fma": "fma", "mad": "fma", "sqrt": "div"}
_CONVERSIONS = re.compile(r"(as|convert)_(\w+?)\d*|vload\d*|vstore\d*|fabs|popcount|clz|ceil|floor|any|all|isnan")


LANGUAGE = {"FLT_MAX": "float", "FLT_MIN": "float", "INFINITY": "float"}
"""Constants of OpenCL C and their types."""


class _Counter:
    """Operations of the functions of a program, each counted once."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.counted: dict[str, Counter[str]] = {}

    def count(self, name: str) -> Counter[str]:
        """Operations of a function; raises ValueError where there is none of that name, or it is not understood."""
        if name not in self.counted:
            if name not in self.source.functions:
                raise ValueError(f"the kernels have no function {name}()")
            function = self.source.functions[name]
            try:
                scope = {key: self.source.kind_of_type(kind) for key, kind in function.parameters.items()}
                self.counted[name] = _Body(self, name, scope).block(function.body)
            except (KeyError, IndexError) as fault:
                raise ValueError(f"{name}(): {fault} is not understood") from None
        return self.counted[name]


class _Body:
    """Statements of one function. `scope` : name -> basic type or struct."""

    def __init__(self, counter: _Counter, name: str, scope: dict[str, str]) -> None:
        self.counter, self.source = counter, counter.source
        self.name, self.scope = name, scope
        self.tokens: list[Token] = []
        self.at = 0
        self.found: Counter[str] = Counter()

    def fault(self, what: str) -> ValueError:
        near = " ".join(self.tokens[max(0, self.at - 6) : self.at + 6])
        return ValueError(f"{self.name}(): {what} is not understood, near '{near}'")

    def block(self, tokens: list[Token]) -> Counter[str]:
        """Operations of a run of statements."""
        outer = self.tokens, self.at, self.found
        self.tokens, self.at, self.found = tokens, 0, Counter()
        while self.at < len(tokens):
            self.statement()
        counted = self.found
        self.tokens, self.at, self.found = outer
        return counted

    def _take_statement(self) -> list[Token]:
        """The tokens of the statement here (those in its braces), and steps over it."""
        if self.tokens[self.at] == "{":
            closed = matching(self.tokens, self.at)
            taken = self.tokens[self.at + 1 : closed]
            self.at = closed + 1
            return taken
        start = self.at
        if self.tokens[self.at] in ("if", "for"):
            self.at = matching(self.tokens, self.at + 1) + 1
            self._take_statement()
            if self.tokens[start] == "if" and self.at < len(self.tokens) and self.tokens[self.at] == "else":
                self.at += 1
                self._take_statement()
        else:
            self.at = self.tokens.index(";", self.at) + 1
        return self.tokens[start : self.at]

    def statement(self) -> None:
        token = self.tokens[self.at]
        if token == "{":
            self.found += self.block(self._take_statement())
        elif token == ";":
            self.at += 1
        elif token == "if":
            self._if()
        elif token == "for":
            self._for()
        elif token in ("while", "do", "switch", "goto"):
            raise self.fault(f"'{token}'")
        elif token in ("break", "continue") or (token == "return" and self.tokens[self.at + 1] == ";"):
            self.at += 2
        elif token == "return":
            self.at += 1
            self.expression()
            self.expect(";")
        elif self._starts_declaration():
            self._declaration()
        else:
            self._assignment()

    def _if(self) -> None:
        """The condition, and the branch that has more to do."""
        closed = matching(self.tokens, self.at + 1)
        self.found += self.block([*self.tokens[self.at + 2 : closed], ";"])
        self.at = closed + 1
        branches = [self.block(self._take_statement())]
        if self.at < len(self.tokens) and self.tokens[self.at] == "else":
            self.at += 1
            branches.append(self.block(self._take_statement()))
        totals = [sum(branch.values()) for branch in branches]
        self.found += branches[totals.index(max(totals))]

    def _for(self) -> None:
        closed = matching(self.tokens, self.at + 1)
        head = " ".join(self.tokens[self.at + 2 : closed])
        rounds = re.fullmatch(r"u?int (\w+) = 0 ; \1 < (\d+)u? ; \+\+ \1", head)
        if not rounds:
            raise self.fault("a loop whose rounds are not constant")
        self.scope[rounds[1]] = "int"
        self.at = closed + 1
        for operation, count in self.block(self._take_statement()).items():
            self.found[operation] += int(rounds[2]) * count

    def _starts_declaration(self) -> bool:
        at = self.at
        while self.tokens[at] in QUALIFIERS:
            at += 1
        follows = self.tokens[at + 1] if at + 1 < len(self.tokens) else ""
        return self.source.is_type(self.tokens[at]) and (follows == "*" or follows.isidentifier())

    def _declaration(self) -> None:
        while self.tokens[self.at] in QUALIFIERS:
            self.at += 1
        kind = self.source.kind_of_type(self.tokens[self.at])
        self.at += 1
        while True:
            while self.tokens[self.at] == "*" or self.tokens[self.at] in QUALIFIERS:
                self.at += 1
            self.scope[self.tokens[self.at]] = kind
            self.at += 1
            while self.tokens[self.at] == "[":
                self.at = matching(self.tokens, self.at) + 1
            if self.tokens[self.at] == "=":
                self.at += 1
                self._initializer()
            if self.tokens[self.at] == ";":
                break
            self.expect(",")
        self.at += 1

    def _initializer(self) -> None:
        if self.tokens[self.at] != "{":
            self.expression()
            return
        self.at += 1
        while self.tokens[self.at] != "}":
            self._initializer()
            if self.tokens[self.at] == ",":
                self.at += 1
        self.at += 1

    def _assignment(self) -> None:
        kind = self.expression()
        token = self.tokens[self.at]
        if token in _ASSIGNMENTS:
            self.at += 1
            value = self.expression()
            if token != "=":
                self.operate(token[:-1], kind, value)
        self.expect(";")

    def expect(self, token: Token) -> None:
        if self.at >= len(self.tokens) or self.tokens[self.at] != token:
            raise self.fault(f"what stands in place of '{token}'")
        self.at += 1

    def operate(self, operator: str, left: str, right: str) -> str:
        """Count one binary operator; returns the kind of its result."""
        floats = is_float(left) or is_float(right)
        if operator in _COMPARISONS:
            self.found["compare" if floats else "other"] += 1
            return "int"
        self.found[_KINDS.get(operator, "other") if floats else "other"] += 1
        return left if is_float(left) else right

    def expression(self, lowest: int = 0) -> str:
        """Parse from here on, counting; returns the kind of the value."""
        kind = self._unary()
        while self.at < len(self.tokens) and _PRECEDENCE.get(self.tokens[self.at], -1) > lowest:
            operator = self.tokens[self.at]
            self.at += 1
            kind = self.operate(operator, kind, self.expression(_PRECEDENCE[operator]))
        if lowest == 0 and self.at < len(self.tokens) and self.tokens[self.at] == "?":
            self.at += 1
            kind = self.expression()
            self.expect(":")
            self.expression()
            self.found["select" if is_float(kind) else "other"] += 1
        return kind

    def _unary(self) -> str:
        token = self.tokens[self.at]
        if token in ("-", "!", "~", "+", "&", "*", "++", "--"):
            self.at += 1
            number = _NUMBER.fullmatch(self.tokens[self.at])
            kind = self._unary()
            if not (number or token in "+&*"):  # a sign of a number, an address and what lies there cost nothing
                self.found["other"] += 1
            return kind
        return self._postfix(self._primary())

    def _primary(self) -> str:
        token = self.tokens[self.at]
        self.at += 1
        if token == "(":
            if self.source.is_type(self.tokens[self.at]):
                return self._cast()
            kind = self.expression()
            self.expect(")")
            return kind
        if _NUMBER.fullmatch(token):
            fraction = not token.lower().startswith("0x") and any(c in token.lower() for c in ".ef")
            return "float" if fraction else "int"
        if self.at < len(self.tokens) and self.tokens[self.at] == "(":
            return self._call(token)
        if token in LANGUAGE:
            return LANGUAGE[token]
        if token in self.scope:
            return self.scope[token]
        raise self.fault(f"the name '{token}'")

    def _cast(self) -> str:
        """A cast or a vector of parts: no operation but that of an integer made a float or the other way."""
        kind = self.source.kind_of_type(self.tokens[self.at])
        self.at = matching(self.tokens, self.at - 1) + 1
        literal = self.tokens[self.at + 1] if self.tokens[self.at] == "(" else self.tokens[self.at]
        if self.tokens[self.at] == "(":
            self.at += 1
            values = self._arguments()
        else:
            values = [self._unary()]
        if len(values) == 1 and is_float(values[0]) != is_float(kind) and not _NUMBER.fullmatch(literal):
            self.found["other"] += 1
        return kind

    def _arguments(self) -> list[str]:
        kinds = []
        while self.tokens[self.at] != ")":
            kinds.append(self.expression())
            if self.tokens[self.at] == ",":
                self.at += 1
        self.at += 1
        return kinds

    def _call(self, name: str) -> str:
        self.at += 1
        kinds = self._arguments()
        if name in self.source.functions:
            self.found += self.counter.count(name)
            return self.source.kind_of_type(self.source.functions[name].kind)
        if name in _BUILTINS:
            kind = next((kind for kind in kinds if is_float(kind)), kinds[0])
            self.found[_BUILTINS[name] if is_float(kind) else "other"] += 1
            return kind
        conversion = _CONVERSIONS.fullmatch(name)
        if not conversion:
            raise self.fault(f"the function {name}()")
        if not (name.startswith(("as_", "vload", "vstore"))):
            self.found["other"] += 1
        return conversion[2] or kinds[0]

    def _postfix(self, kind: str) -> str:
        while self.at < len(self.tokens):
            token = self.tokens[self.at]
            if token == "[":
                closed = matching(self.tokens, self.at)
                self.found += self.block([*self.tokens[self.at + 1 : closed], ";"])
                self.at = closed + 1
            elif token in (".", "->"):
                member = self.tokens[self.at + 1]
                fields = self.source.structs.get(kind)
                kind = self.source.kind_of_type(fields[member]) if fields is not None else kind
                self.at += 2
            elif token in ("++", "--"):
                self.found["other"] += 1
                self.at += 1
            else:
                break
        return kind
