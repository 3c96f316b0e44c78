"""Effects beyond the declared arm, one file per law; `CATALOGUE` maps the names that files use."""

from armflex.laws.effects.catalogue import CATALOGUE as CATALOGUE
from armflex.laws.effects.law import Effect as Effect
from armflex.laws.effects.law import EffectLaw as EffectLaw
from armflex.laws.effects.law import LoadLaw as LoadLaw
from armflex.laws.effects.law import ModelLaw as ModelLaw
from armflex.laws.effects.law import TwistLaw as TwistLaw
from armflex.laws.effects.spot import Spot as Spot
