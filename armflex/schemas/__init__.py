"""Versioned JSON schemas of an arm.toml and of what commands write with --json; `docs/_ext/schemas.py` makes them."""

from armflex.schemas.shipped import ARM as ARM
from armflex.schemas.shipped import HERE as HERE
from armflex.schemas.shipped import read_schema as read_schema
from armflex.schemas.shipped import schema_names as schema_names
