"""Documents of the journal together with the counts that are kept for each."""

from handover_broker.storage.entries import DocumentKind
from handover_broker.storage.journal import Journal


def documents_with_counts(
    journal: Journal, kind: DocumentKind, counts: DocumentKind
) -> dict[str, list[tuple[str, bytes, bytes | None]]]:
    """Return the documents of a kind by tenant, each with its id and its document of the kind `counts`."""
    counted = {(tenant, counted_id): body for tenant, counted_id, body in journal.documents(counts)}
    documents: dict[str, list[tuple[str, bytes, bytes | None]]] = {}
    for name, document_id, body in journal.documents(kind):
        documents.setdefault(name, []).append((document_id, body, counted.get((name, document_id))))
    return documents
