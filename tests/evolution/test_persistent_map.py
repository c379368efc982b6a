"""Promise: a mapping that grew stays what it was, whatever is grown from it later, and equals the plain dictionary."""

from hypothesis import given
from hypothesis import strategies as st

from tacevo.evolution.archive import PersistentMap

#: Which of the mappings so far is grown (counted from the latest), the key, the value.
STEPS = st.lists(st.tuples(st.integers(0, 5), st.sampled_from("abcdef"), st.integers()), max_size=40)


@given(STEPS)
def test_every_mapping_equals_the_copy_that_it_saves(steps: list[tuple[int, str, int]]) -> None:
    """However they branch, all mappings have the entries, in the order, of dictionaries that are copied each time."""
    grown: list[PersistentMap[str, int]] = [PersistentMap()]
    copied: list[dict[str, int]] = [{}]
    for back, key, value in steps:
        place = max(0, len(grown) - 1 - back)
        grown.append(grown[place].adding(key, value))
        copied.append({**copied[place], key: value})
    for ours, plain in zip(grown, copied, strict=True):
        assert list(ours.items()) == list(plain.items())
        assert (len(ours), "f" in ours, ours.get("f")) == (len(plain), "f" in plain, plain.get("f"))


def test_mapping_may_grow_while_an_earlier_one_is_read() -> None:
    """An iteration that has begun goes on over the keys of its own mapping."""
    before = PersistentMap[str, int]().adding("a", 1).adding("b", 2)
    keys = iter(before)
    assert next(keys) == "a"
    before.adding("c", 3)
    assert list(keys) == ["b"]
