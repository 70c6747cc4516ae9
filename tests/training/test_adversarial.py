from hypothesis import given
from hypothesis import strategies as st

from moveset.training.adversarial import of_another

LABELS = st.lists(st.sampled_from(["walk", "turn", "jump", "sit"]), min_size=1, max_size=2, unique=True)


@given(st.lists(LABELS, min_size=2, max_size=12))
def test_the_text_of_another_shares_no_label_where_any_row_shares_none(contents):
    for own, other in zip(contents, of_another(contents), strict=True):
        strangers = [row for row in contents if not set(row) & set(own)]
        assert contents[other] in strangers or not strangers


@given(st.lists(LABELS, min_size=2, max_size=12))
def test_nobody_gets_their_own_text(contents):
    assert all(row != other for row, other in enumerate(of_another(contents)))


def test_without_labels_in_common_it_is_the_next_one():
    assert of_another([["walk"], ["jump"], ["sit"]]) == [1, 2, 0]
