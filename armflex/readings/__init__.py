"""What an instrument reads of an arm: one file for every kind, and all of a campaign's together.

Nothing outside this room knows how many numbers a reading has, or what of the arm it sees.
"""

from armflex.readings.kind import Kind as Kind
from armflex.readings.orientation import Orientation as Orientation
from armflex.readings.position import Position as Position
from armflex.readings.readings import Readings as Readings
from armflex.readings.readings import unread as unread
