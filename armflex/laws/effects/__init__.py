"""Effects beyond the declared arm, one file per law; `CATALOGUE` maps the names that files use."""

from armflex.laws.effects.catalogue import CATALOGUE as CATALOGUE
from armflex.laws.effects.effect import Effect as Effect
from armflex.laws.effects.effect import EffectLaw as EffectLaw
from armflex.laws.effects.effect import LoadLaw as LoadLaw
from armflex.laws.effects.effect import ModelLaw as ModelLaw
from armflex.laws.effects.effect import TwistLaw as TwistLaw
from armflex.laws.effects.location import Location as Location
