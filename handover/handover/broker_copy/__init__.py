"""Copies what an NGSI-LD broker has into another one, and compares both.

It uses only ETSI GS CIM 009. Names travel as IRIs, so that no @context of either broker changes a meaning
(`entity_form`). Entities are read page by page and written in batches; one that is in the target with the
same content counts as copied. So the same command finishes a copy that was interrupted, without a file of its
state. No answer to a write is trusted: at the end every entity of the source is read from both brokers and
compared (`entity_copy`).

The temporal evolution (history) is not copied: the standard lets a broker decide which times it has.
"""
