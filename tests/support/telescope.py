"""A mount of two axes with a tube that bends, and a star that it points at."""

MOUNT = """
[robot]
dh = "modified"
gravity = [0, 0, -9.81]
tool = { xyz = [1, 0, 0], rpy = [0, 0, 0] }
[robot.joint]
az = { alpha_deg = 180, mass = 10 }
el = { alpha_deg = -90, mass = 10, com = [0.5, 0, 0] }
[flexure]
tube = { joint = "el", compliance = [0, 0, 0, 1e-6, 1e-6, 1e-6] }
[prior]
joint_offset = 5e-3
geometry = 2e-3
compliance = 2.0
[instrument.star]
kind = "direction"
link = "flange"
axis = [1, 0, 0]
azimuth = "north_to_east"
sigma = 5e-6
"""
