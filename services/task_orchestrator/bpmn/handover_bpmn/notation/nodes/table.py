"""Table of flow nodes: each kind with its reader, the parts that it may have, and its rules."""

from collections.abc import Mapping

from handover_bpmn.model import Kind
from handover_bpmn.notation.nodes import events, gateways, tasks
from handover_bpmn.notation.nodes.node_type import NodeType

NODE_TYPES: Mapping[Kind, NodeType] = {
    node_type.kind: node_type for node_type in (*events.NODE_TYPES, *gateways.NODE_TYPES, *tasks.NODE_TYPES)
}
