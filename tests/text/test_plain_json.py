from __future__ import annotations

import json
import math

from hypothesis import given
from hypothesis import strategies as st

from cyclekit.text.plain_json import json_text

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


@given(VALUES, st.booleans())
def test_every_document_comes_back_with_null_for_what_is_no_number(value: object, ascii_only: bool) -> None:
    text = json_text(value, ascii_only=ascii_only)
    assert json.loads(text, parse_constant=_refuse) == _nulled(value)
    assert not ascii_only or text.isascii()


def test_keys_become_text_and_tuples_lists() -> None:
    assert json.loads(json_text({0.05: (1, 2)})) == {"0.05": [1, 2]}


def _refuse(name: str) -> None:
    raise AssertionError(f"{name} is no JSON")


def _nulled(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _nulled(entry) for key, entry in value.items()}
    return [_nulled(entry) for entry in value] if isinstance(value, list) else value
