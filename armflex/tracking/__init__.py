"""Calibration kept up with an arm, reading by reading."""

from armflex.tracking.reading import Reading as Reading
from armflex.tracking.tracker import Step as Step
from armflex.tracking.tracker import Tracker as Tracker
from armflex.tracking.watch import Change as Change
