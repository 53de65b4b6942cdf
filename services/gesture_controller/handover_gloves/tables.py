"""The tables of people and gloves in the database of the gesture controller."""

from sqlalchemy import Boolean, Column, Integer, MetaData, String, Table, Text

VERSION = 1

tables = MetaData()
gloves = Table(
    "controller_gloves",
    tables,
    Column("name", String(64), primary_key=True),
    Column("hand", String(5), nullable=False),
    Column("person", String(200)),
    Column("declared", Boolean, nullable=False),
)
fits = Table(
    "controller_fits",
    tables,
    Column("glove", String(64), primary_key=True),
    Column("person", String(200), primary_key=True),  # empty: the wearer is not named
    Column("thresholds", Text),
    Column("previous", Text),
    Column("recognizer", String(64)),
    Column("learnt", Text, nullable=False),
    Column("changed_at", String(40), nullable=False),
)
tokens = Table(
    "controller_glove_tokens",
    tables,
    Column("glove", String(64), primary_key=True),
    Column("sha256", String(64), nullable=False),
)
people = Table(
    "controller_people",
    tables,
    Column("name", String(200), primary_key=True),
    Column("title", Text),
)
commands = Table(
    "controller_commands",
    tables,
    Column("person", String(200), primary_key=True),
    Column("command", Integer, primary_key=True, autoincrement=False),
    Column("gesture", Text),  # NULL: this person has no gesture for the command
)
gestures = Table(
    "controller_gestures",
    tables,
    Column("person", String(200), primary_key=True),
    Column("name", String(200), primary_key=True),
    Column("shape", Text, nullable=False),
)
