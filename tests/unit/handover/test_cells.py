"""An id says of which cell an entity is; what has another form is of none."""

from hypothesis import given
from hypothesis import strategies as st

from handover.cells import cell_of
from handover.settings import Settings

names = st.from_regex(r"[A-Za-z0-9_.-]{1,12}", fullmatch=True)


@given(cell=names, kind=st.sampled_from(["Task", "Device", "Alert"]), name=st.text(min_size=1, max_size=20))
def test_the_cell_is_found_in_every_id_that_the_settings_make(cell: str, kind: str, name: str) -> None:
    made = Settings(factory=cell, _env_file=None).entity_id(kind, name)
    assert cell_of(made) == (None if name.startswith("urn:") else cell)


@given(st.sampled_from(["urn:ngsi-ld:Device:lamp-1", "urn:ngsi-ld", "https://example.org/a:b:c:d:e", ""]))
def test_an_id_of_another_form_is_of_no_cell(entity: str) -> None:
    assert cell_of(entity) is None
