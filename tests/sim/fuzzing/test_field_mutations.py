import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.types import deserialize, typestore
from sim.fuzzing.field_mutations import MUTATIONS, FieldMutator
from sim.fuzzing.fields import replaced
from sim.fuzzing.value_types import (
    BOOLEAN,
    Array,
    Boolean,
    Message,
    Number,
    Text,
    message_type,
    zero,
)
from tests.sim.fuzzing.workbench import data, doing, frozen, results, scan, scans, stamp

KINDS = list(MUTATIONS)
TYPES = [name for name in sorted(typestore().fielddefs) if "/msg/" in name]
NUMBERS = ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"]
seeds = st.integers(0, 2**32).map(np.random.default_rng)


def filled(kind):
    """A value in which no sequence is empty."""
    match kind:
        case Message():
            message = zero(kind)
            for name, inner in kind.fields.items():
                message = replaced(message, (name,), filled(inner))
            return message
        case Array(Number(name), bound, fixed):
            return np.ones(bound if fixed else min(3, bound or 3), name)
        case Array(Boolean(), bound, fixed):
            return np.ones(bound if fixed else min(3, bound or 3), bool)
        case Array(element, bound, fixed):
            return [filled(element) for _ in range(bound if fixed else min(3, bound or 3))]
        case Text():
            return "text"
    return zero(kind)


def leaves(value, way=()):
    """Every value in a message by its way, written down to bits."""
    if hasattr(value, "__msgtype__"):
        for name, _ in typestore().fielddefs[value.__msgtype__][1]:
            yield from leaves(getattr(value, name), (*way, name))
    elif isinstance(value, list | np.ndarray):
        for place, element in enumerate(value):
            yield from leaves(element, (*way, place))
    else:
        bits = np.float64(value).tobytes() if isinstance(value, float | np.floating) else value
        yield way, bits


def test_one_value_of_any_message_type_is_changed_and_the_result_can_be_sent():
    for name in TYPES:
        kind = message_type(name)
        whole = filled(kind)
        before = data(whole)
        mutator = FieldMutator.of(kind, [], KINDS)
        for seed in range(8):
            mutant, _, text = mutator(whole, np.random.default_rng(seed))
            changed = dict(leaves(mutant)).items() ^ dict(leaves(whole)).items()
            assert len({way for way, _ in changed}) == 1, (name, text)
            assert data(deserialize(data(mutant), name)) == data(mutant)
        assert data(whole) == before


@given(seeds)
def test_a_message_of_empty_sequences_only_is_returned_unchanged(rng):
    kind = message_type("tf2_msgs/msg/TFMessage")
    empty = zero(kind)
    assert FieldMutator.of(kind, [], KINDS)(empty, rng) == (empty, 0.0, "nothing to mutate")


def test_all_fields_have_their_turn():
    kind = message_type("sensor_msgs/msg/LaserScan")
    mutator = FieldMutator.of(kind, [], ["bit_flip"])
    texts = [mutator(scan(), np.random.default_rng(seed))[2] for seed in range(400)]
    fields = {text.removeprefix("bit_flip ").split("[")[0].split(" ")[0] for text in texts}
    assert fields == {
        "header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "angle_min", "angle_max",
        "angle_increment", "time_increment", "scan_time", "range_min", "range_max", "ranges",
        "intensities",
    }  # fmt: skip


@given(seeds, st.sampled_from(NUMBERS), st.data())
def test_a_bit_flip_flips_one_bit(rng, name, data):
    limits = np.iinfo(name)
    old = data.draw(st.integers(int(limits.min), int(limits.max)))
    new = MUTATIONS["bit_flip"](old, Number(name), rng)
    bits = 8 * np.dtype(name).itemsize
    assert ((old ^ new) % 2**bits).bit_count() == 1
    assert limits.min <= new <= limits.max


@given(seeds, st.sampled_from(["float32", "float64"]), st.floats(width=32, allow_nan=False))
def test_a_bit_flip_of_a_real_number_flips_one_bit_of_its_representation(rng, name, old):
    new = MUTATIONS["bit_flip"](old, Number(name), rng)
    if not np.isnan(new):  # whose payload Python may not keep
        one, other = (
            int.from_bytes(np.array(value, name).tobytes(), "little") for value in (old, new)
        )
        assert (one ^ other).bit_count() == 1


@given(seeds, st.sampled_from(KINDS), st.text(st.characters(codec="utf-8"), max_size=8))
def test_a_mutated_text_is_another_one_that_can_be_sent(rng, name, old):
    new = MUTATIONS[name](old, Text(), rng)
    assert new != old
    new.encode()


@given(seeds, st.sampled_from(KINDS), st.booleans())
def test_a_mutated_boolean_is_inverted(rng, name, old):
    assert MUTATIONS[name](old, BOOLEAN, rng) is (not old)


@given(seeds, st.sampled_from(NUMBERS))
def test_boundaries_are_those_of_the_type(rng, name):
    limits = np.iinfo(name)
    ends = {limits.min, limits.min + 1, 0, limits.max - 1, limits.max}
    assert MUTATIONS["boundary"](5, Number(name), rng) in ends


def test_only_the_fields_named_are_mutated():
    compiled = doing("mutate: {fields: [header.stamp, range_max], mutations: [arithmetic]}")
    for message, result in zip(scans(60), results(compiled, scans(60)), strict=True):
        mutant = result.outputs[0].message
        assert mutant.ranges.tobytes() == message.ranges.tobytes()
        assert mutant.header.frame_id == message.header.frame_id
        assert (mutant.header.stamp, mutant.range_max) != (message.header.stamp, message.range_max)


def test_as_many_values_are_mutated_as_asked_for():
    (result,) = results(doing("mutate: {fields: [ranges], count: 3}"), [scan()])
    assert len(result.truth.detail.split("; ")) == 3


def test_the_truth_names_field_kind_and_change():
    compiled = doing("mutate: {fields: [range_max], mutations: [boundary]}")
    message = scan()
    (result,) = results(compiled, [frozen(message)])
    new = result.outputs[0].message.range_max
    assert result.truth.detail == f"boundary range_max 20.0 -> {new!r}"
    assert result.truth.magnitude == abs(new - 20.0)
    assert result.truth.stamp_ns == stamp(0)
