"""The messages that ROS derives from services and actions to transmit and hash them.

`X_SendGoal` and `X_GetResult` are the services of an action, and `X_FeedbackMessage` is its topic. `X_Event`
and the bare `X` exist only for the hash (REP-2016, and the interface types of rosidl).
"""

from handover_ros.types.definition import Definition, Field, FieldType, Many

UUID = "unique_identifier_msgs/msg/UUID"
TIME = "builtin_interfaces/msg/Time"
EVENT_INFO = "service_msgs/msg/ServiceEventInfo"
CANCEL_GOAL = "action_msgs/srv/CancelGoal"
GOAL_STATUS_ARRAY = "action_msgs/msg/GoalStatusArray"


def of_action(action: str) -> list[Definition]:
    """Return the messages that ROS derives from an action, `example_interfaces/action/Fibonacci`."""
    return [
        Definition(f"{action}_SendGoal_Request", (_one("goal_id", UUID), _one("goal", f"{action}_Goal"))),
        Definition(f"{action}_SendGoal_Response", (_one("accepted", "bool"), _one("stamp", TIME))),
        Definition(f"{action}_GetResult_Request", (_one("goal_id", UUID),)),
        Definition(
            f"{action}_GetResult_Response", (_one("status", "int8"), _one("result", f"{action}_Result"))
        ),
        Definition(
            f"{action}_FeedbackMessage", (_one("goal_id", UUID), _one("feedback", f"{action}_Feedback"))
        ),
    ]


def hashed_with_service(service: str) -> list[Definition]:
    """Return the types that only the hash of a service uses: its event, and the service as a whole."""
    optional = [
        Field(name, FieldType(f"{service}_{part}", Many.SEQUENCE, 1))
        for name, part in (("request", "Request"), ("response", "Response"))
    ]
    whole = [
        _one(name, f"{service}_{part}")
        for name, part in (
            ("request_message", "Request"),
            ("response_message", "Response"),
            ("event_message", "Event"),
        )
    ]
    return [
        Definition(f"{service}_Event", (_one("info", EVENT_INFO), *optional)),
        Definition(service, tuple(whole)),
    ]


def hashed_with_action(action: str) -> list[Definition]:
    """Return the types that only the hash of an action uses: the action as a whole."""
    parts = [
        ("goal", "Goal"),
        ("result", "Result"),
        ("feedback", "Feedback"),
        ("send_goal_service", "SendGoal"),
        ("get_result_service", "GetResult"),
        ("feedback_message", "FeedbackMessage"),
    ]
    return [Definition(action, tuple(_one(name, f"{action}_{part}") for name, part in parts))]


def _one(name: str, base: str) -> Field:
    return Field(name, FieldType(base))
