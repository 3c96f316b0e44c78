"""The front door: URDF in, validated robot out."""

from armflex.robot.robot import Corrections as Corrections
from armflex.robot.robot import Robot as Robot
from armflex.robot.robot import Site as Site
from armflex.robot.robot import load_robot as load_robot
