"""The operator that stores values for later messages."""

from collections.abc import Mapping

from sim.fuzzing.compile_context import CompileContext, Spec
from sim.fuzzing.fields import converter
from sim.fuzzing.scenario import Key
from sim.fuzzing.step import Operator, Step
from sim.fuzzing.value_types import Table, Text, Type, strip_padding

STORED_NS = "_stored_ns"  # when a row of a table was stored; expressions cannot name it


def compile_store(spec: Spec, key: Key, context: CompileContext) -> Operator:
    """Store a value, or a row of a table, for later messages."""
    kind = context.state.fields.get(spec["into"])
    if kind is None:
        known = ", ".join(context.state.fields) or "none"
        raise context.scenario.error(
            (*key, "into"), f"expected a name under state, found {spec['into']}; there are: {known}"
        )
    if isinstance(kind, Table):
        return _compile_store_row(spec, key, context, kind)
    return _compile_store_value(spec, key, context, kind)


def _compile_store_value(spec: Spec, key: Key, context: CompileContext, kind: Type) -> Operator:
    into, convert = spec["into"], converter(kind)
    value = context.term(spec["value"], (*key, "value"))
    context.check_fits(value, kind, (*key, "value"))

    def apply(step: Step) -> None:
        state = step.env["state"]
        state[into] = convert(value(step), state[into])

    return Operator(apply, value.cost)


def _compile_store_row(spec: Spec, key: Key, context: CompileContext, table: Table) -> Operator:
    """Store a row of a table; in a full table, it replaces the oldest row."""
    if "key" not in spec:
        raise context.scenario.error(key, f"expected the key key: {spec['into']} is a map")
    row, place = spec["value"], (*key, "value")
    if not isinstance(row, Mapping) or set(row) != set(table.row.fields):
        names = ", ".join(table.row.fields)
        raise context.scenario.error(place, f"expected a value for each of {names}")
    cells = []
    for name, text in row.items():
        kind = table.row.fields[name]
        value = context.term(text, (*place, name))
        context.check_fits(value, kind, (*place, name))
        cells.append((name, converter(kind), value))
    row_name = context.term(spec["key"], (*key, "key"), Text)

    def apply(step: Step) -> None:
        rows = step.env["state"][spec["into"]]
        row = {name: convert(value(step), 0) for name, convert, value in cells}
        key = strip_padding(row_name(step))
        rows.pop(key, None)
        if len(rows) == table.max_size:
            del rows[next(iter(rows))]
        rows[key] = {**row, STORED_NS: step.stamp_ns}

    return Operator(apply, row_name.cost + sum(value.cost for _, _, value in cells))
