"""Laws that are learned on the whole arm: parameters about what was declared, and the twist's answer to each."""

from armflex.laws.learned.learned_law import LearnedLaw as LearnedLaw
from armflex.laws.learned.learned_law import Learning as Learning
from armflex.laws.learned.learned_law import learned_law as learned_law
from armflex.laws.learned.learned_law import read_learning as read_learning
from armflex.laws.learned.seen import Seen as Seen
from armflex.laws.learned.seen import seen_in as seen_in
