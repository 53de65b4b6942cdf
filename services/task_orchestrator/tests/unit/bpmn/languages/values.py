"""Random JSON values for the tests of the expression languages."""

from hypothesis import strategies as st

TEXTS = ["7", "2026-05-01", "2026-05-01T08:00:00Z", "9999-12-31T23:59:59", "PT5M", "-P1M", '{"k": 1}']
JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.integers(-5, 5)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=8)
    | st.sampled_from(
        ["7", "2026-05-01", "2026-05-01T08:00:00Z", "9999-12-31T23:59:59", "PT5M", "-P1M", '{"k": 1}']
    ),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["k", "part", ""]), inner, max_size=3)
    ),
    max_leaves=6,
)
