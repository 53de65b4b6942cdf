"""Flow nodes: how each kind is read and checked.

`table` has one `NodeType` for each kind: the reader, the child elements that it may have, and its rules. To
add one, add its kind to `handover_bpmn.model.nodes` and remove it from `REFUSED` there, and add its type to
`NODE_TYPES` of `events`, `gateways` or `tasks`. What its token does, if not what others do, is in
`execution`. An event definition is a line of `event_definitions`.

Modules, lowest first: `data`, `performers`, `retries`, `task_extensions` (parts of activities), `loops`,
`activities` (the Task of an activity), `event_definitions`, `node_type`, then the kinds, then `table`.
"""
