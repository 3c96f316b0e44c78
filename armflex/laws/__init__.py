"""Joint deformation models, one file per law; `LAWS` maps the names that arm.toml uses."""

from armflex.laws.declared import LAWS as LAWS
from armflex.laws.declared import LawModel as LawModel
from armflex.laws.declared import read_law as read_law
from armflex.laws.joint.beam import Beam as Beam
from armflex.laws.joint.beam import Section as Section
from armflex.laws.joint.carried import AtNode as AtNode
from armflex.laws.joint.linear import LinearFit as LinearFit
from armflex.laws.joint.linear import LinearLaw as LinearLaw
from armflex.laws.joint.position_dependent import PositionDependentLaw as PositionDependentLaw
from armflex.laws.joint.structural import StructuralLaw as StructuralLaw
from armflex.laws.joint.structural import SubJoint as SubJoint
from armflex.laws.law import Law as Law
from armflex.laws.law import Row as Row
