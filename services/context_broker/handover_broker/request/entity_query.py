"""An entity query: selection, view, order, linked entities and page.

Clauses 5.7.2, 6.4.3.2 and 6.23. Query parameters and a Query document are two forms of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from handover_broker.model.context import Context
from handover_broker.model.representation.rendering import View
from handover_broker.query import linked, ordering
from handover_broker.query.earlier_names import with_earlier_names
from handover_broker.query.linked import Join
from handover_broker.query.ordering import Ordering
from handover_broker.query.pages import Window, mark_of
from handover_broker.query.selection import Selection, search
from handover_broker.request.entity_responses import Showing, entities_answer
from handover_broker.request.query_parameters import selection_of, view_of, window_of
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.storage.store import Store


@dataclass(frozen=True, slots=True)
class EntityQuery:
    """A query of one request; `mark` identifies its order in the links to pages."""

    context: Context
    view: View
    selection: Selection
    window: Window
    order: Ordering | None
    join: Join | None
    mark: int


def entity_query_of(
    request: RequestContext,
    parameters: Mapping[str, str],
    context: Context,
    any_of: tuple[Selection, ...] = (),
) -> EntityQuery:
    """Return the query in `parameters`, for entities that match one of `any_of` if there are any.

    Raises a problem (400) that names what is invalid or not allowed.
    """
    context = with_earlier_names(context, parameters.get("type"))
    view = view_of(request, context)
    selection = selection_of(parameters, context, any_of)
    order = ordering.ordering(parameters, context.terms.expand)
    join = join_of(parameters, view, selection)
    mark = mark_of(context.text, "" if order is None else order.text)
    return EntityQuery(context, view, selection, window_of(request, mark=mark), order, join, mark)


def join_of(parameters: Mapping[str, str], view: View, selection: Selection | None = None) -> Join | None:
    """Return the request for linked entities; raise a problem (400) if more links are used than followed."""
    join = linked.join_of(parameters)
    hops = 0 if selection is None or selection.query is None else selection.query.hops
    if hops or view.projection is not None:
        linked.check_depth(join, view.projection, hops)
    return join


async def answered(request: RequestContext, store: Store, asking: EntityQuery) -> Response:
    """Return the response to a query of the entities in `store`."""
    page = await search(store, asking.selection, asking.window, asking.order)
    showing = Showing(asking.context, asking.view, asking.join, store.get)
    return entities_answer(request, page, asking.window, showing, asking.mark)
