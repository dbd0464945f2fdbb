"""Functions of a scenario, and names in expressions."""

import pytest

from sim.fuzzing.expressions import MAX_DEPTH, MAX_OPERATIONS, compile_expression
from sim.fuzzing.grammar import ExpressionError
from sim.fuzzing.scopes import Function, Scope
from sim.fuzzing.value_types import FLOAT, Text
from tests.sim.fuzzing.language import NAMES, VECTORS

pytestmark = pytest.mark.usefixtures("quiet")


@pytest.mark.parametrize("ring", [("f",), ("f", "g"), ("f", "g", "h")])
def test_functions_that_call_each_other_in_a_ring_are_refused_unused(ring):
    functions = {
        name: Function(("x",), f"fn.{ring[(k + 1) % len(ring)]}(x)") for k, name in enumerate(ring)
    }
    with pytest.raises(ExpressionError, match="cannot call themselves, but fn.* calls fn."):
        Scope({}, functions)


def test_functions_that_double_each_other_are_refused_before_they_cost_anything():
    functions = {"f0": Function(("x",), "x + x")}
    for k in range(1, 64):
        functions[f"f{k}"] = Function(("x",), f"fn.f{k - 1}(x) + fn.f{k - 1}(x)")
    with pytest.raises(ExpressionError, match=f"nested deeper|more than {MAX_OPERATIONS}"):
        compile_expression("fn.f63(1)", Scope({}, functions))
    with pytest.raises(ExpressionError, match=f"more than {MAX_OPERATIONS} operations"):
        compile_expression("fn.f12(1)", Scope({}, functions))


def test_depth_counts_through_functions():
    functions = {"f0": Function(("x",), "-" * 20 + "x")}
    for k in range(1, 5):
        functions[f"f{k}"] = Function(("x",), "-" * 10 + f"fn.f{k - 1}(x)")
    compile_expression("fn.f1(1)", Scope({}, functions))
    with pytest.raises(ExpressionError, match=f"nested deeper than {MAX_DEPTH}"):
        compile_expression("fn.f4(1)", Scope({}, functions))


def test_a_function_does_not_see_what_is_local_to_its_caller():
    scope = Scope(NAMES, {"leak": Function((), "r + 1")}, VECTORS, ("r",))
    with pytest.raises(ExpressionError, match="'r' is unknown"):
        compile_expression("fn.leak()", scope)


def test_a_parameter_hides_a_name_of_the_scenario_in_its_function_only():
    scope = Scope(NAMES, {"same": Function(("t",), "t")})
    assert compile_expression("fn.same(5) + t", scope)({"t": 2.0}) == 7.0


def test_calls_with_different_arguments_are_distinguished():
    scope = Scope(
        {"t": FLOAT},
        {
            "inc": Function(("x",), "x + 1"),
            "two": Function(("x",), "fn.inc(x) * 10 + fn.inc(x + 1)"),
        },
    )
    assert compile_expression("fn.two(t) + fn.two(t + 5)", scope)({"t": 0.0}) == 12.0 + 67.0


def test_a_function_cannot_draw():
    with pytest.raises(ExpressionError, match="a function cannot draw"):
        Function((), "1 + uniform(0, 1)")


@pytest.mark.parametrize(
    "name", ["__class__", "_x", "rng", "fn", "min", "true", "lambda", "a b", "", "1x", "a.b"]
)
def test_names_that_are_private_reserved_or_no_names_cannot_be_given(name):
    with pytest.raises(ExpressionError, match="is no name|is taken"):
        Scope({}, locals={name: FLOAT})
    with pytest.raises(ExpressionError, match="is no name|is taken"):
        Function((name,), "1")


def test_a_name_is_given_once_and_vectors_are_local_numbers():
    with pytest.raises(ExpressionError, match="'t' is taken"):
        Scope({"t": FLOAT}, locals={"t": FLOAT})
    with pytest.raises(ExpressionError, match="'x' is taken"):
        Function(("x", "x"), "1")
    with pytest.raises(ExpressionError, match="'name' is no local number"):
        Scope({}, locals={"name": Text(8)}, vectors=("name",))
