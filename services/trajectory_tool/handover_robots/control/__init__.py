"""Control: a person moves a robot by hand, alone or together with it.

- `leasing`: one person at a time per robot, who waits, hands over or takes over (`handover.control`).
- `tool_motion`: the velocity of the tool becomes velocities of the joints.
- `shared_control`: the velocities of a person and of an autonomous motion are blended (IoHRT, equation 1).
- `intent`: which of several goals the person steers to.
- `session`: one person who controls one robot; `routes.control`: its WebSocket.

It is advisory: the dead-man function here is software on a network, and no enabling device (ISO 10218-1).
"""
