"""Costs of a setup and of an edge evaluation: the sums of Fig. 10, and operators counted in the kernels' source."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import pytest

from clrast.opencl.features import Edges, Precision, Projection
from clrast.opencl.kernels import source_text
from clrast.options import AVAILABLE_PRECISIONS
from clrast.scene.camera import PLANAR_PROJECTIONS
from clrast.study import operation_counts
from clrast.study.c_preprocessor import preprocess
from clrast.study.kernel_operations import KernelOperations, count_operations, count_source
from clrast.study.operation_counts import FUNCTIONS, PAPER, PROGRAM, Cost, disagreements, kernel_cost, paper_cost

# Fig. 10


@pytest.mark.parametrize(
    ("edges", "setup", "pixel"),
    [
        # 2D: 3 + 12 + 36, 3 + 3 + 3, 1 + 2, 1 + 9; 6, 2 + 1 + 1, 2, 2
        (Edges.PROJECTED, 51 + 9 + 3 + 10, 6 + 4 + 2 + 2),
        # homogeneous: 36, 3 * (3 + 3), 1 + 2, 1 + 9, 6; 6, 1 + 2, 1, 1
        (Edges.HOMOGENEOUS, 36 + 18 + 3 + 10 + 6, 6 + 3 + 1 + 1),
        # 3D: 9 + 9 + 9, 1 + 2, 9 + 18; 6, 2, 3 + 1
        (Edges.SPATIAL, 27 + 3 + 27, 6 + 2 + 4),
        # Cramer's rule: 9, 9 + 9, 1 + 2, 9 + 18; 6, 2, 3 + 1
        (Edges.BARYCENTRIC, 9 + 18 + 3 + 27, 6 + 2 + 4),
    ],
)
def test_costs_are_the_sums_of_the_lines(edges: Edges, setup: int, pixel: int) -> None:
    assert paper_cost(edges) == Cost(setup, pixel)


def test_every_contradiction_of_the_figure_is_found() -> None:
    found = {(each.edges, each.part, each.printed, each.counted) for each in disagreements()}
    assert found == {
        ("2D", "setup", "72", "73"),
        ("2D", "setup", "39", "38"),
        ("2D", "setup", "3 ADD, 3 MUL, 3 MADD", "6 ADD, 3 MUL, 3 MADD"),
        ("2D", "pixel", "2 MUL, 8 MADD, 1 RCP", "5 MUL, 8 MADD, 1 RCP"),
        ("2D", "pixel", "14", "11"),
        ("2D homogeneous", "pixel", "3 MUL, 10 MADD, 1 RCP", "2 MUL, 8 MADD, 1 RCP"),
        ("2D homogeneous", "pixel", "14", "11"),
    }
    taken = {(each.edges, each.part): each.counted for each in disagreements() if each.what.startswith("total")}
    assert taken[("2D homogeneous", "pixel")] == str(paper_cost(Edges.HOMOGENEOUS).pixel)


def test_a_wrong_total_would_be_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The 3D column agrees with itself; one number changed does not."""
    column = PAPER[Edges.SPATIAL]
    assert not any(each.edges == "3D" for each in disagreements())
    wrong = replace(column, setup=replace(column.setup, printed_total=58))
    monkeypatch.setattr(operation_counts, "PAPER", MappingProxyType({Edges.SPATIAL: wrong}))
    assert [(each.printed, each.counted) for each in disagreements()] == [("58", "57"), ("58", "57")]


# The preprocessor


@pytest.mark.parametrize(
    ("text", "tokens"),
    [
        ("a // b\n/* c\nd */ e", "a e"),
        ("#if X == 2 && !defined(Y)\na\n#elif X\nb\n#else\nc\n#endif", "a"),
        ("#if X > 5\na\n#elif X - 1\nb\n#else\nc\n#endif", "b"),
        ("#if UNKNOWN\na\n#else\nc\n#endif", "c"),
        ("#if 0\n#if 1\na\n#else\nb\n#endif\n#elif 1\nc\n#endif", "c"),
        ("#ifndef X\na\n#endif\n#ifdef X\nb\n#endif", "b"),
        ("#define TWO(a, b) ((a) + \\\n (b))\nTWO(f(1, 2), X);", "( ( f ( 1 , 2 ) ) + ( 2 ) ) ;"),
        ("#define A B\n#define B A\nA", "A"),
        ("#define F(a) a\nF + F(x)", "F + x"),
        ("#define A 1\n#undef A\nA", "A"),
        ("x <<= 0x1Fu; p->y >= 1.5e-3f", "x <<= 0x1Fu ; p -> y >= 1.5e-3f"),
    ],
)
def test_preprocessor(text: str, tokens: str) -> None:
    assert preprocess(text, {"X": "2"}) == tokens.split()


# The counter

HEAD = "typedef float16 float_v; typedef int16 int_v; typedef struct { float_v x, y; int_v on; } Pair;\n"


def count(body: str, head: str = "") -> KernelOperations:
    """Of a function with floats a, b, integers i, j, a struct p and an array q."""
    signature = "static void f(float_v a, float b, int i, int_v j, Pair p, const float *restrict q)"
    return count_source(f"{HEAD}{head}{signature} {{ {body} }}", ("f",), {})[0]


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("return a + b - 2.0f * a / b;", {"add": 2, "mul": 1, "div": 1}),
        ("return i + 2 * i - i / 3;", {"other": 4}),
        ("return a * i;", {"mul": 1}),
        ("const float_v c = a * b, d = c + c;", {"mul": 1, "add": 1}),
        ("float_v c; c = a; c += b; i += 1;", {"add": 1, "other": 1}),
        ("Pair r = {a + b, a * b, j};", {"add": 1, "mul": 1}),
        ("p.x = p.y * b; return p.on + j;", {"mul": 1, "other": 1}),
        ("return q[i + 1] + q[0];", {"add": 1, "other": 1}),
        ("return a > b ? a : b;", {"compare": 1, "select": 1}),
        ("return i > 1 ? i : 2;", {"other": 2}),
        ("return (a == b) & (a < b);", {"compare": 2, "other": 1}),
        ("return -a;", {"other": 1}),
        ("return -0.5f * a;", {"mul": 1}),
        ("return (float_v)(0.0f) + (float_v)(1) + (float)i;", {"add": 2, "other": 1}),
        ("return as_float16(j) + b;", {"add": 1}),
        ("return convert_float16(j) * b;", {"mul": 1, "other": 1}),
        ("return max(a, b) + max(i, 2);", {"compare": 1, "add": 1, "other": 1}),
        ("return fma(a, b, a);", {"fma": 1}),
        ("for (uint k = 0; k < 3; ++k) { a += b * q[k]; }", {"add": 3, "mul": 3}),
        ("for (int k = 0; k < 2; ++k) for (int m = 0; m < 4; ++m) a += b;", {"add": 8}),
        ("if (a > b) a += b; else { a += b * b; a -= b; }", {"compare": 1, "add": 2, "mul": 1}),
        ("if (a > b) { a += b; }", {"compare": 1, "add": 1}),
        ("{ const float_v c = a + b; } ; return;", {"add": 1}),
    ],
)
def test_operators(body: str, expected: dict[str, int]) -> None:
    assert count(body) == KernelOperations(**expected)


def test_calls_count_what_they_do() -> None:
    g = "static float_v g(float_v a) { return a * a; }"
    h = "static Pair h(float_v a) { Pair r = {g(a) + a, a}; return r; }"
    assert count("return h(a + b).x * g(b);", g + h) == KernelOperations(add=2, mul=3)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("while (a > b) a += b;", "f.*'while'"),
        ("for (int k = 0; k < i; ++k) a += b;", "rounds are not constant"),
        ("return unheard_of(a);", r"unheard_of\(\)"),
        ("return c + a;", "the name 'c'"),
        ("return p.z + a;", "z"),
        ("return a b;", "in place of ';'"),
    ],
)
def test_what_is_not_understood_is_an_error(body: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        count(body)


def test_a_missing_function_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"no function g\(\)"):
        count_source(HEAD, ("g",), {})


# The kernels

CROSS = {"add": 3, "mul": 6}
DOT = {"add": 2, "mul": 3}


def test_vector_functions() -> None:
    names = ("cross3", "dot3", "dot3s", "add", "subtract", "edge_value")
    found = count_operations(
        PROGRAM, names, edges=Edges.SPATIAL, precision=Precision.MIDPOINT, projection=Projection.PERSPECTIVE
    )
    expected = (CROSS, DOT, DOT, {"add": 3}, {"add": 3}, {"add": 2, "mul": 2})
    assert found == tuple(KernelOperations(**operations) for operations in expected)


def test_setup_and_sample_of_the_3d_edges() -> None:
    """Midpoint form, perspective. A change of these expressions in cl/ changes these numbers with them."""
    # An edge: a + b and b - a, their cross product; c from two dot products, gx and gy from one each.
    edge_add = 3 + 3 + CROSS["add"] + (2 * DOT["add"] + 1) + 2 * DOT["add"]
    edge_mul = CROSS["mul"] + 4 * DOT["mul"]
    # Beside three edges: corners from the eye, the volume, the nearness plane of four dot products and three quotients.
    setup_add = 3 * edge_add + 3 * 3 + DOT["add"] + (2 * DOT["add"] + 1) + 2 * DOT["add"]
    setup_mul = 3 * edge_mul + DOT["mul"] + 4 * DOT["mul"]
    # A sample: its place twice (for the edges and for the nearness), three edges and the nearness at it.
    sample_add, sample_mul = 2 * 2 + 4 * 2, 4 * 2
    cost = kernel_cost(Edges.SPATIAL)
    assert cost is not None
    setup, sample = cost
    assert (setup.add, setup.mul, setup.div, setup.fma) == (setup_add, setup_mul, 3, 0) == (74, 69, 3, 0)
    assert (sample.add, sample.mul, sample.div, sample.fma) == (sample_add, sample_mul, 0, 0) == (12, 8, 0, 0)
    # One fill rule an edge (two comparisons by sign and one by 0), the volume's signs; one comparison of nearness.
    assert (setup.compare, sample.compare, sample.select) == (3 * 3 + 3, 1, 1)


def test_plain_products_and_the_orthographic_form() -> None:
    """`fast` has ra + ra in place of both sums; the orthographic form has no sum and three products more for c."""
    fast = kernel_cost(Edges.SPATIAL, Precision.FAST)
    parallel = kernel_cost(Edges.SPATIAL, Precision.MIDPOINT, Projection.ORTHOGRAPHIC)
    assert fast is not None and parallel is not None
    assert (fast[0].add, fast[0].mul) == (74 - 3 * 3, 69)
    # An edge: b - a, a cross product, ra + rb, and c from two dot products, a factor and a sum.
    assert (parallel[0].add, parallel[0].mul) == (74, 69 + 3)


@pytest.mark.parametrize("edges", Edges)
def test_every_kind_of_edge_is_understood(edges: Edges) -> None:
    for precision in AVAILABLE_PRECISIONS:
        if precision == "fixed":
            continue  # `compare`, which counts operations, refuses it
        for projection in PLANAR_PROJECTIONS:  # it refuses others, too
            named = {"precision": Precision[precision.upper()], "projection": Projection[projection.upper()]}
            setup, sample = count_operations(PROGRAM, FUNCTIONS, edges=edges, **named)
            assert setup.arithmetic > sample.arithmetic > 8


def test_a_change_of_the_source_changes_the_numbers() -> None:
    text = source_text(PROGRAM)
    old = "return (c + at.x * gx) + at.y * gy;"
    assert text.count(old) == 1
    defined = {"VECTOR_WIDTH": "16", "TILE_LOG2": "5", "PRECISION": "2", "BINNING": "1"}
    before = count_source(text, ("rasterize_block",), defined)[0]
    changed = text.replace(old, "return ((c + at.x * gx) + at.y * gy) * 1.5f;")
    after = count_source(changed, ("rasterize_block",), defined)[0]
    assert after.mul == before.mul + 4
