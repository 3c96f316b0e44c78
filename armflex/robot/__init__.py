"""The front door: URDF in, validated robot and Pinocchio models out."""

from armflex.robot.model import Corrections as Corrections
from armflex.robot.model import FlexModel as FlexModel
from armflex.robot.model import Site as Site
from armflex.robot.model import build_model as build_model
from armflex.robot.robot import Robot as Robot
from armflex.robot.robot import load_robot as load_robot
