"""The grammar of expressions: a closed list of nodes of Python's grammar.

``sim.fuzzing.expressions`` defines the meaning of the nodes and checks their types.
"""

import ast
import functools
import keyword
import math
import warnings
from collections.abc import Iterable

from oracle_pipeline.bags.errors import OracleError
from sim.fuzzing.functions import BUILTINS
from sim.fuzzing.value_types import MAX_TEXT

FUNCTIONS = "fn"  # the functions of a scenario are called as fn.<name>(...)
MAX_LENGTH = 1000  # characters of one expression
MAX_EXPONENT = 16

_LANGUAGE = (
    "numbers, texts, names, fields, [index], calls of built-ins and of fn.<name>, "
    "+ - * / // % **, comparisons, and, or, not, a if b else c"
)
_NODES = (
    *(ast.Constant, ast.Name, ast.Load, ast.Attribute, ast.Subscript, ast.Call),
    *(ast.Tuple, ast.List, ast.IfExp),
    *(ast.BoolOp, ast.And, ast.Or, ast.UnaryOp, ast.Not, ast.USub, ast.UAdd),
    *(ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.FloorDiv, ast.Mod, ast.Pow),
    *(ast.Compare, ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE),
)


class ExpressionError(OracleError):
    """An expression, a function or a name is invalid; the text states where and what is wrong."""


@functools.lru_cache(maxsize=1024)  # a function is parsed again for each of its calls
def parse(text: str) -> ast.expr:
    """Return the tree of a text; names and types are not checked.

    The same text gives the same tree, which must not be changed.

    Raises
    ------
    ExpressionError
        If the text is too long, is not an expression, or uses something outside the language.
    """
    if len(text) > MAX_LENGTH:
        raise ExpressionError(
            f"{_shown(text)} has {len(text)} characters; at most {MAX_LENGTH} are allowed."
        )
    if "\0" in text:  # Python's message depends on its release
        raise ExpressionError(
            f"Column {text.strip().index(chr(0)) + 1} of {_shown(text)}: there is a NUL; "
            f"expected {_LANGUAGE}."
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Python's warnings are errors here
            tree = ast.parse(text.strip(), mode="eval").body
    except SyntaxError as error:
        raise ExpressionError(
            f"Column {error.offset or 1} of {_shown(text)}: {error.msg}; expected {_LANGUAGE}."
        ) from None
    except (ValueError, MemoryError, RecursionError) as error:
        raise ExpressionError(
            f"{_shown(text)} cannot be parsed: {str(error) or 'nested too deeply'}; "
            f"expected {_LANGUAGE}."
        ) from None
    for node in ast.walk(tree):
        wrong = _wrong_with(node)
        if wrong:
            raise error_at(text, node, wrong)
    return tree


def _wrong_with(node: ast.AST) -> str | None:
    """Return why a node is not valid in the language, or None."""
    match node:
        case ast.Name(name) | ast.Attribute(attr=name) if name.startswith("_"):
            return f"{name!r} is private"
        case ast.Call(keywords=[_, *_]):
            return "arguments are given by position"
        case ast.Call() if isinstance(node.func, ast.Name):
            name = node.func.id
            return None if name in BUILTINS else f"{name!r} is no built-in: {listed(BUILTINS)}"
        case ast.Call() if called_function(node) is None:
            return "only built-ins and fn.<name> can be called"
        case ast.Constant(value):
            return _wrong_with_constant(value)
        case ast.BinOp(op=ast.Pow(), right=exponent):
            return _wrong_with_exponent(exponent)
        case _ if not isinstance(node, _NODES):
            return f"{type(node).__name__} is not of the language, which has {_LANGUAGE}"
    return None


def _wrong_with_constant(value: object) -> str | None:
    match value:
        case bool():
            return None
        case int():
            return None if value < 2**63 else "a whole number must be less than 2**63"
        case float():
            return None if math.isfinite(value) else "a number must be finite; infinity is inf"
        case str():
            return None if len(value) <= MAX_TEXT else f"a text has at most {MAX_TEXT} characters"
        case _:
            return f"a constant of type {type(value).__name__} is not of the language"


def _wrong_with_exponent(node: ast.expr) -> str | None:
    match node:
        case ast.Constant(value) | ast.UnaryOp(ast.USub(), ast.Constant(value)) if (
            isinstance(value, int | float) and value <= MAX_EXPONENT
        ):
            return None
        case _:
            return f"an exponent must be a constant from -{MAX_EXPONENT} to {MAX_EXPONENT}"


def called_function(node: ast.AST) -> str | None:
    """Return the name of the function that a node calls as ``fn.<name>(...)``, or None."""
    match node:
        case ast.Call(ast.Attribute(ast.Name(id), name)) if id == FUNCTIONS:
            return name
    return None


def check_names(names: Iterable[str], reserved: Iterable[str] = ()) -> None:
    """Check that names can be used in expressions and are given once.

    Raises
    ------
    ExpressionError
        If one is private, reserved, a keyword or no identifier, or is given twice.
    """
    taken = set(reserved)
    for name in names:
        if not name.isidentifier() or name.startswith("_") or keyword.iskeyword(name):
            raise ExpressionError(
                f"{_shown(name)} is no name; a name starts with a letter, has letters, digits and "
                "_, and is no word of the language."
            )
        if name in taken:
            raise ExpressionError(f"The name {name!r} is taken; choose another.")
        taken.add(name)


def error_at(text: str, node: ast.AST, what: str) -> ExpressionError:
    """Return an error with the place of a node in a text."""
    text = text.strip()
    where = f"In {_shown(text)}"
    if isinstance(node, ast.expr):
        column = len(text.encode()[: node.col_offset].decode()) + 1
        where = f"Column {column} of {_shown(text)}"
    return ExpressionError(f"{where}: {what}.")


def listed(names: Iterable[str]) -> str:
    """Return names as a list for messages."""
    return ", ".join(names) or "none"


def _shown(text: str) -> str:
    return repr(text if len(text) <= 80 else text[:77] + "...")
