import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit_adapters.text.json_parts import BrokenJson, number, parts, point, points

_LEAF = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5)
_ANY = st.recursive(_LEAF, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4))


@pytest.mark.slow
@given(value=st.lists(_ANY, max_size=6), indent=st.sampled_from([None, 1]))
def test_an_array_comes_apart_into_its_elements(value, indent):
    assert [element for _, element in parts(json.dumps(value, indent=indent))] == value


@given(value=st.dictionaries(st.text(), _ANY, max_size=6), indent=st.sampled_from([None, 1]))
def test_an_object_comes_apart_into_its_members(value, indent):
    assert dict(parts(json.dumps(value, indent=indent))) == value


@given(frames=st.lists(_ANY, max_size=6), first=_ANY, last=_ANY)
def test_the_array_inside_comes_apart_too_and_the_rest_stays_whole(frames, first, last):
    found = list(parts(json.dumps({"first": first, "frames": frames, "last": last}), inside="frames"))
    assert found == [("first", first), *(("frames", frame) for frame in frames), ("last", last)]


@given(value=st.lists(st.lists(st.integers(), max_size=3), min_size=1, max_size=6), data=st.data())
def test_a_cut_array_gives_only_whole_elements_and_says_that_it_is_cut(value, data):
    text = json.dumps(value)
    cut = text[: data.draw(st.integers(0, len(text) - 1))]
    found = []
    with pytest.raises(BrokenJson):
        found.extend(element for _, element in _keep(found, cut))
    assert found == value[: len(found)]


def _keep(found, text):
    for part in parts(text):
        found.append(part[1])
    return []


@pytest.mark.parametrize("text", ["", "1", "[1 2]", '{"a" 1}', "{1: 2}", "[1] 2", "[" * 5000, "[" + "9" * 5000 + "]"])
def test_what_is_no_document_is_broken(text):
    with pytest.raises(BrokenJson):
        list(parts(text))


def test_the_words_that_recorders_write_for_unknown_numbers_are_no_numbers():
    ((_, values),) = parts('{"a": [NaN, -Infinity, null, true, "1", 1e400]}')
    assert [number(value) for value in values] == [None] * 6
    assert number(10**400) is None
    assert math.isclose(number(3) or 0.0, 3.0)


def test_a_point_is_three_numbers():
    assert point([1, 2.0, -3]) == (1.0, 2.0, -3.0)
    assert [point(value) for value in ([1, 2], [1, 2, None], "123", [1, 2, 1e11], None)] == [None] * 5


_COORDINATE = st.integers(-(10**12), 10**12) | st.floats() | st.none() | st.booleans() | st.text(max_size=2)


@given(values=st.lists(st.lists(_COORDINATE, min_size=2, max_size=4) | _COORDINATE, max_size=4))
def test_many_points_are_what_each_of_them_is(values):
    wanted = [point(value) for value in values]
    found = [None if math.isnan(row[0]) else tuple(row) for row in points(values).tolist()]
    numbers = all(isinstance(v, int | float) for value in values if isinstance(value, list) for v in value)
    if not numbers or not any(isinstance(v, bool) for value in values if isinstance(value, list) for v in value):
        assert found == wanted


def test_what_is_garbled_ends_the_document_there_and_reads_no_further():
    taken = []

    def pieces():
        for count in range(10_000):
            taken.append(count)
            yield '{"a": [1, 2]},' * 1000 if count else '[{"a" 1},'

    with pytest.raises(BrokenJson):
        list(parts(pieces()))
    assert len(taken) < 20
