"""A six-axis arm on a rail: seven joints, the first one prismatic."""

from pathlib import Path

from handover_robots.robots.urdf import read_model

ROBOT = read_model(
    Path(__file__).parent / "rail.urdf",
    name="Rail arm",
    tip="tip",
    home={"rail": 0.4, "shoulder": -0.6, "elbow": 1.4, "wrist_bend": 0.8},
    max_acceleration={
        "rail": 1.5,
        "base": 5.0,
        "shoulder": 5.0,
        "elbow": 5.0,
        "forearm_roll": 10.0,
        "wrist_bend": 10.0,
        "flange_roll": 10.0,
    },
    max_jerk=60.0,
    labels={
        "rail": {"en": "Rail", "de": "Linearachse", "fi": "Kisko"},
        "base": {"en": "Base", "de": "Basis", "fi": "Jalusta"},
        "shoulder": {"en": "Shoulder", "de": "Schulter", "fi": "Olkapää"},
        "elbow": {"en": "Elbow", "de": "Ellbogen", "fi": "Kyynärpää"},
        "forearm_roll": {"en": "Forearm roll", "de": "Unterarmdrehung", "fi": "Kyynärvarren kierto"},
        "wrist_bend": {"en": "Wrist bend", "de": "Handgelenk", "fi": "Ranteen taivutus"},
        "flange_roll": {"en": "Flange roll", "de": "Flanschdrehung", "fi": "Laipan kierto"},
    },
)
