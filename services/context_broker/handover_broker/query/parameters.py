"""The query parameters of all operations, in one table.

Every list of parameters is derived from it: what an operation accepts, what filters entities, what is
passed on to context sources, and which members of documents (Query, Subscription) correspond to them.
"""

from dataclasses import dataclass
from enum import Enum, Flag, auto
from typing import Final


class ValueKind(Enum):
    """How the value is read, from a URL and from the member of a document."""

    TEXT = auto()
    LIST = auto()
    """Text with commas; a document has a list of texts."""
    NAMES = auto()
    """Names of attributes with commas; a document has such a text, or a list."""
    FLAG = auto()
    """true or false."""
    NUMBER = auto()
    GEO = auto()
    """A part of the document's member `geoQ`."""
    ORDER = auto()
    """A part of the document's member `ordering`."""


class Use(Flag):
    """The operations, or parts of operations, that accept a parameter."""

    NONE = 0
    VIEW = auto()
    """The representation of entities (clause 6.3.7)."""
    PAGE = auto()
    """Pagination (clause 6.3.10)."""
    POSITION = auto()
    """Pagination by positions in an order."""
    LINKS = auto()
    """Linked entities (clause 4.5.23)."""
    ORDER = auto()
    """The order of entities (clause 4.23)."""
    GEO = auto()
    """Geo-queries (clause 4.10)."""
    SELECTION = auto()
    """The selection of entities (clause 6.4.3.2)."""
    MAP = auto()
    """Entity maps (clause 6.4.3.2)."""
    TIME = auto()
    """Time ranges of temporal queries (clause 4.11)."""
    AGGREGATION = auto()
    """Aggregated values (clause 4.5.19)."""
    PURGE = auto()
    """Purge (clause 6.4.3.3)."""
    SEARCH = auto()
    """The search for context source registrations (clause 6.8.3.2)."""
    SEARCH_CRITERION = auto()
    """Parameters of which that search needs one."""
    SUBSCRIPTION = auto()
    """Members of a subscription (clause 5.2.12)."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter. `member` is the member of a Query document that corresponds to it, if there is one.

    `is_filter`: it is evaluated on whole entities, a part of one does not suffice. `is_forwarded`: it
    is passed on to context sources unchanged. `since` is the version of NGSI-LD that introduced it.
    """

    name: str
    uses: Use
    kind: ValueKind = ValueKind.TEXT
    member: str | None = None
    is_filter: bool = False
    is_forwarded: bool = False
    since: tuple[int, int] = (1, 3)


_SELECTED: Final = Use.SELECTION | Use.PURGE | Use.SEARCH
_CRITERION: Final = _SELECTED | Use.SEARCH_CRITERION

PARAMETERS: Final = (
    Parameter("type", _CRITERION),
    Parameter("id", _CRITERION),
    Parameter("attrs", Use.VIEW | Use.PURGE | Use.SEARCH | Use.SEARCH_CRITERION, ValueKind.LIST, "attrs"),
    # Filters
    Parameter("q", _CRITERION | Use.SUBSCRIPTION, member="q", is_filter=True, is_forwarded=True),
    Parameter(
        "expandValues",
        Use.SELECTION | Use.PURGE | Use.SUBSCRIPTION,
        ValueKind.NAMES,
        "expandValues",
        is_filter=True,
        since=(1, 8),
    ),
    Parameter(
        "jsonKeys",
        Use.SELECTION | Use.PURGE | Use.SUBSCRIPTION,
        ValueKind.NAMES,
        "jsonKeys",
        is_filter=True,
        since=(1, 8),
    ),
    Parameter(
        "scopeQ",
        _CRITERION | Use.SUBSCRIPTION,
        member="scopeQ",
        is_filter=True,
        is_forwarded=True,
        since=(1, 4),
    ),
    Parameter(
        "georel",
        Use.GEO | _CRITERION | Use.SUBSCRIPTION,
        ValueKind.GEO,
        "geoQ",
        is_filter=True,
        is_forwarded=True,
    ),
    Parameter("geometry", Use.GEO | _SELECTED, ValueKind.GEO, "geoQ", is_filter=True, is_forwarded=True),
    Parameter("coordinates", Use.GEO | _SELECTED, ValueKind.GEO, "geoQ", is_filter=True, is_forwarded=True),
    Parameter("geoproperty", Use.GEO | _SELECTED, ValueKind.GEO, "geoQ", is_filter=True, is_forwarded=True),
    Parameter("idPattern", _CRITERION, is_forwarded=True),
    Parameter("csf", _CRITERION | Use.SUBSCRIPTION, member="csf"),
    Parameter("splitEntities", Use.SELECTION | Use.SUBSCRIPTION, ValueKind.FLAG, "splitEntities"),
    # Representation
    Parameter("options", Use.VIEW | Use.PAGE, ValueKind.LIST),
    Parameter("format", Use.VIEW),
    Parameter("pick", Use.VIEW, ValueKind.LIST, "pick"),
    Parameter("omit", Use.VIEW, ValueKind.LIST, "omit"),
    Parameter("lang", Use.VIEW | Use.SUBSCRIPTION, member="lang"),
    Parameter("datasetId", Use.VIEW | Use.SUBSCRIPTION, ValueKind.LIST, "datasetId"),
    Parameter("geometryProperty", Use.VIEW),
    Parameter("local", Use.VIEW | Use.PAGE | Use.PURGE, ValueKind.FLAG),
    Parameter("join", Use.LINKS, member="join"),
    Parameter("joinLevel", Use.LINKS, ValueKind.NUMBER, "joinLevel"),
    Parameter("containedBy", Use.LINKS, ValueKind.LIST, "containedBy"),
    # Order and pages
    Parameter("orderBy", Use.ORDER, ValueKind.ORDER, "ordering"),
    Parameter("orderFrom", Use.ORDER, ValueKind.ORDER, "ordering"),
    Parameter("orderGeometry", Use.ORDER, ValueKind.ORDER, "ordering"),
    Parameter("collation", Use.ORDER, ValueKind.ORDER, "ordering"),
    Parameter("limit", Use.PAGE, ValueKind.NUMBER),
    Parameter("offset", Use.PAGE, ValueKind.NUMBER),
    Parameter("count", Use.PAGE, ValueKind.FLAG),
    Parameter("place", Use.POSITION),
    Parameter("entityMap", Use.MAP, ValueKind.FLAG, "entityMap"),
    Parameter("entityMapLifetime", Use.MAP, member="entityMapLifetime"),
    # History
    Parameter("timerel", Use.TIME | Use.SEARCH),
    Parameter("timeAt", Use.TIME | Use.SEARCH),
    Parameter("endTimeAt", Use.TIME | Use.SEARCH),
    Parameter("timeproperty", Use.TIME | Use.SEARCH),
    Parameter("lastN", Use.TIME, ValueKind.NUMBER),
    Parameter("aggrMethods", Use.AGGREGATION, ValueKind.LIST),
    Parameter("aggrPeriodDuration", Use.AGGREGATION),
    # Single operations
    Parameter("keep", Use.PURGE, ValueKind.LIST),
    Parameter("drop", Use.PURGE, ValueKind.LIST),
    Parameter("deleteAll", Use.NONE, ValueKind.FLAG),
    Parameter("details", Use.NONE, ValueKind.FLAG),
    Parameter("reload", Use.NONE, ValueKind.FLAG),
)
"""All parameters that more than one module knows, and all booleans."""


def names_for(uses: Use) -> frozenset[str]:
    """Return the names of the parameters with any of the uses."""
    return frozenset(parameter.name for parameter in PARAMETERS if parameter.uses & uses)


def members_for(uses: Use) -> frozenset[str]:
    """Return the members of documents that correspond to parameters with any of the uses."""
    return frozenset(
        parameter.member for parameter in PARAMETERS if parameter.member is not None and parameter.uses & uses
    )


BOOLEANS: Final = frozenset(parameter.name for parameter in PARAMETERS if parameter.kind is ValueKind.FLAG)
FILTERS: Final = tuple(parameter.name for parameter in PARAMETERS if parameter.is_filter)
"""Parameters that filter whole entities."""
FORWARDED: Final = tuple(parameter.name for parameter in PARAMETERS if parameter.is_forwarded)
"""Parameters that are passed on to context sources unchanged."""
KIND_BY_MEMBER: Final = {
    parameter.member: parameter.kind for parameter in PARAMETERS if parameter.member is not None
}
"""The members of a Query document, and how they are read."""
FILTER_MEMBERS: Final = tuple(
    dict.fromkeys(
        parameter.member for parameter in PARAMETERS if parameter.is_filter and parameter.member is not None
    )
)
"""The members of a Query or a subscription that filter whole entities."""
FORWARDED_TEXTS: Final = tuple(
    parameter.member
    for parameter in PARAMETERS
    if parameter.is_forwarded and parameter.kind is ValueKind.TEXT and parameter.member is not None
)
"""The members of a Query with text that is passed on unchanged."""
SINCE: Final = {
    parameter.member: parameter.since
    for parameter in PARAMETERS
    if parameter.member is not None and parameter.since > (1, 3)
}
"""Members that an earlier version of NGSI-LD refuses, with the version that introduced them."""
