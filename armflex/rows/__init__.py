"""What was commanded and recorded, row by row: it needs no reading to be asked about."""

from armflex.rows.rows import Driven as Driven
from armflex.rows.rows import Rows as Rows
