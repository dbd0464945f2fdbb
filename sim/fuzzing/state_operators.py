"""Operators that store values for later messages."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from sim.fuzzing.compile_context import CompileContext, Spec
from sim.fuzzing.fields import Convert, converter
from sim.fuzzing.scenario import Key
from sim.fuzzing.step import Operator, Step, Term
from sim.fuzzing.value_types import Table, Text, strip_padding

STORED_NS = "_stored_ns"  # when a row of a table was stored; expressions cannot name it


@dataclass(frozen=True, slots=True)
class Store:
    """Store a value for later messages."""

    into: str
    convert: Convert
    value: Term
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, context: CompileContext) -> Self:
        """Check and compile."""
        kind = context.state.fields[spec["into"]]
        value = context.term(spec["value"], (*key, "value"))
        context.check_fits(value, kind, (*key, "value"))
        return cls(spec["into"], converter(kind), value, value.cost)

    def __call__(self, step: Step) -> None:
        """Apply the operator."""
        state = step.env["state"]
        state[self.into] = self.convert(self.value(step), state[self.into])


@dataclass(frozen=True, slots=True)
class _StoreRow:
    """Store a row of a table; in a full table, it replaces the oldest row."""

    into: str
    max_size: int
    key: Term
    columns: tuple[tuple[str, Convert, Term], ...]
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, context: CompileContext, table: Table) -> Self:
        """Check and compile."""
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
        name = context.term(spec["key"], (*key, "key"), Text)
        cost = name.cost + sum(value.cost for _, _, value in cells)
        return cls(spec["into"], table.max_size, name, tuple(cells), cost)

    def __call__(self, step: Step) -> None:
        """Apply the operator."""
        rows = step.env["state"][self.into]
        row = {name: convert(value(step), 0) for name, convert, value in self.columns}
        key = strip_padding(self.key(step))
        rows.pop(key, None)
        if len(rows) == self.max_size:
            del rows[next(iter(rows))]
        rows[key] = {**row, STORED_NS: step.stamp_ns}


def compile_store(spec: Spec, key: Key, context: CompileContext) -> Operator:
    """Check and compile the storage of a value, or of a row of a table."""
    kind = context.state.fields.get(spec["into"])
    if kind is None:
        known = ", ".join(context.state.fields) or "none"
        raise context.scenario.error(
            (*key, "into"), f"expected a name under state, found {spec['into']}; there are: {known}"
        )
    if isinstance(kind, Table):
        return _StoreRow.compile(spec, key, context, kind)
    return Store.compile(spec, key, context)
