"""What the keys of an arm.toml and the columns of a table mean: the documentation lists them from here.

Which there are, of what type and with what default, it finds by asking the readers; a test says which of them has no
line here. A key stands under its table, with NAME for a name that is yours and KIND where a table has kinds.
"""

from __future__ import annotations

from typing import NamedTuple


class Key(NamedTuple):
    """A key or a column: what it means, its unit, and its default where the reader's own words would not say it."""

    meaning: str
    unit: str = ""
    default: str = ""


_FLEXURE = {
    "model": Key("the joint deformation model, see the laws below"),
    "file": Key("the law that `armflex train`, or the part that `armflex fem` wrote, relative to this file"),
    "rpy": Key(
        "of a part that `armflex fem` wrote: turns the axes of its mesh into those of the joint", "rad", "0 0 0"
    ),
    "compliance": Key(
        "deflection by load, in the axes fx fy fz mx my mz: the diagonal, or the full symmetric matrix",
        "m/N, rad/Nm, mixed",
    ),
    "stiffness": Key("load by deflection, instead of `compliance`", "N/m, Nm/rad, mixed"),
    "joint_stiffness": Key("about or along the drive's own axis, instead of `compliance`", "Nm/rad or N/m"),
    "relative_std": Key("how well the law is known: one standard deviation, relative", "1", "0: taken as exact"),
    "node": Key("the place in the joint's frame to which the law applies; default: the flexure's origin", "m"),
    "compliance_q1": Key("the change per joint position", "…/rad or …/m", "0"),
    "compliance_q2": Key("per square of it", "…/rad² or …/m²", "0"),
    "compliance_q3": Key("per cube of it", "…/rad³ or …/m³", "0"),
    "depends_on": Key("the joint on whose position it depends", default="the flexure's own joint"),
    "energy": Key("w'Cw/2 at which the compliance has fallen to 1/√2 of that under small loads", "J"),
    "nodes": Key("name and place of every node of the structure", "m"),
    "tip": Key("the node that carries on to the next link"),
    "components": Key("6, or 3 for forces and shifts alone"),
    "subjoint": Key("compliant places between nodes and the ground, see below"),
    "beam": Key("Euler-Bernoulli beams between nodes, see below"),
    "learn": Key("`calibrate` learns this law from readings of the tip"),
    "neurons": Key("size of a learned network, 1 to 30 or so"),
}

KEYS: dict[str, dict[str, Key]] = {
    "": {
        "robot": Key("the robot"),
        "payload": Key("what may be carried, a table for each; `none` always exists"),
        "flexure": Key("where the arm bends, a table for each"),
        "link": Key("links that bend, a table for each, by the name of the link"),
        "joint": Key("joints without a drive, a table for each"),
        "loop": Key("links that are joined once more, a table for each"),
        "cylinder": Key("driven lengths between two links, a table for each"),
        "spring": Key("springs between two links, a table for each"),
        "preset": Key("flexures that replace or join those declared, chosen by `--preset NAME`"),
        "measurement": Key("how the arm is measured"),
        "instrument": Key("instruments that read the arm beside, or instead of, x y z; a table for each"),
        "prior": Key("standard deviations of the parameters that `calibrate` fits"),
        "effect": Key("effects beyond the flexures, in order"),
        "calibration": Key("what `calibrate` or `trace` found; written, not meant to be edited"),
    },
    "joint.NAME": {
        "passive": Key("whether the joint has no drive: no column, no torque about its axis", default="false"),
        "q0": Key("of a passive joint: where it is near in the first row, which chooses how loops close", "rad or m"),
    },
    "loop": {
        "name": Key("its name"),
        "link": Key("one of the links that it joins"),
        "at": Key("the point, in the frame of that link", "m"),
        "to": Key("the other link"),
        "at_to": Key("the point, in the frame of the other link", "m"),
        "kind": Key("`revolute`, `spherical`, `cylindrical` or `fixed`"),
        "axis": Key("of a revolute or cylindrical one, in the frame of `link`", "1"),
        "compliance": Key("of its pin, 6 numbers or 6 × 6, axes of `link`", "m/N, rad/Nm", "0: rigid"),
        "relative_std": Key("relative standard uncertainty of that", "1", "0"),
    },
    "cylinder.NAME": {
        "link": Key("the link of one pin"),
        "at": Key("that pin, in the frame of its link", "m"),
        "to": Key("the link of the other pin"),
        "at_to": Key("that pin, in the frame of its link", "m"),
        "lower": Key("least length between the pins", "m"),
        "upper": Key("greatest length between the pins", "m"),
        "effort": Key("greatest force", "N", "none"),
        "stiffness": Key("along it", "N/m", "rigid"),
        "bore": Key("instead of `stiffness`: diameter of the piston; the stroke is `upper` less `lower`", "m"),
        "rod": Key("diameter of the piston rod", "m", "0"),
        "bulk_modulus": Key("of the oil", "Pa"),
        "dead_volume": Key("oil beside the stroke on each side of the piston", "m³", "0"),
        "relative_std": Key("relative standard uncertainty of that", "1", "0"),
    },
    "spring.NAME": {
        "link": Key("the link of one end"),
        "at": Key("that end, in the frame of its link", "m"),
        "to": Key("the link of the other end"),
        "at_to": Key("that end, in the frame of its link", "m"),
        "rate": Key("of a linear spring: change of its tension with its length", "N/m"),
        "free_length": Key("its length where it carries nothing", "m"),
        "preload": Key("instead of `free_length`: its tension at `length0`", "N"),
        "pressure": Key("of a gas spring, instead of `rate`: over that of the surroundings, at `length0`", "Pa"),
        "area": Key("of a gas spring", "m²"),
        "length0": Key("the distance of the ends at which `preload` or `pressure` is meant", "m"),
        "exponent": Key("of a gas spring: pressure × length^exponent is constant", "1", "1: constant temperature"),
    },
    "link.NAME": {
        "file": Key("the part that `armflex fem` wrote: held where the link begins, loaded where its next joint is"),
        "xyz": Key("place of the mesh's origin in the link's frame", "m", "0 0 0"),
        "rpy": Key("turn of the mesh's axes in the link's frame", "rad", "0 0 0"),
    },
    "robot": {
        "urdf": Key("the robot's URDF, relative to this file", default="**required** without `dh`"),
        "dh": Key("instead of a URDF: the form of the rows `[robot.joint.NAME]`"),
        "joint": Key("with `dh`: a row for every joint, base to tip"),
        "tip": Key("the link whose motion is reported", default="**required**; with `dh`: `flange`"),
        "base": Key("the link in whose frame positions, loads and results are meant", default="the URDF's root"),
        "gravity": Key("acceleration of gravity in the base frame", "m/s²", "0 0 -9.81, with a flag"),
        "tool": Key(
            "`xyz` [m] and `rpy` [rad]: the tip frame beyond the link `tip`, as in a controller's tool", "m, rad"
        ),
        "mount": Key("`rpy` of the base in a level world, instead of turning `gravity`", "rad"),
        "payload_rating": Key("heaviest payload without a flag", "kg", "none"),
        "damping_ratio": Key("damping of vibrations over the critical one, 0 to 1", default="0.01, with a flag"),
        "locked": Key("joints beside the chain, or of it, held still at a position", "rad or m"),
        "allow_massless": Key("accept links without mass on the chain"),
    },
    "robot.joint.NAME": {
        "theta": Key("Denavit-Hartenberg parameter, to which the position of a turning joint is added", "rad", "0"),
        "d": Key("the same, to which the position of a sliding joint is added", "m", "0"),
        "a": Key("the same", "m", "0"),
        "alpha": Key("the same", "rad", "0"),
        "beta": Key("Hayati's, between nearly parallel axes", "rad", "0"),
        "kind": Key("how the joint moves, along its z"),
        "lower": Key("lowest position", "rad or m", "none"),
        "upper": Key("highest position", "rad or m", "none"),
        "mass": Key("of the link that it moves", "kg"),
        "com": Key("centre of mass in the frame that moves with the joint: z its axis, x along a", "m", "0 0 0"),
    },
    "robot.tool": {
        "xyz": Key("place of the tool's tip in the link `tip`", "m"),
        "rpy": Key("roll, pitch and yaw of it about the link's axes, as in a URDF", "rad", "0 0 0"),
    },
    "robot.mount": {"rpy": Key("roll, pitch and yaw of the base in a level world", "rad")},
    "robot.locked": {"NAME": Key("position of the joint", "rad or m")},
    "payload.NAME": {
        "mass": Key("of what is carried", "kg"),
        "com": Key("centre of mass in the tip frame", "m"),
        "inertia": Key("ixx iyy izz ixy ixz iyz about the centre of mass; only motion needs it", "kg m²", "none"),
    },
    "flexure.NAME": {
        "joint": Key("its joint: the flexure is in the joint's child frame, just outboard of its motion"),
        **_FLEXURE,
    },
    "flexure.NAME.nodes": {"NAME": Key("place of the node in the flexure's frame", "m")},
    "flexure.NAME.subjoint": {
        "at": Key("the node that it holds"),
        "holds": Key("components that it holds", default="all six"),
        **_FLEXURE,
    },
    "flexure.NAME.beam": {
        "between": Key("the two nodes that it joins"),
        "file": Key(
            "a part that `armflex fem` wrote, held at the first node and loaded at the second; then no numbers"
        ),
        "rpy": Key("of such a part: turns the axes of its mesh into those of the joint", "rad", "0 0 0"),
        "E": Key("Young's modulus", "Pa"),
        "G": Key("shear modulus", "Pa"),
        "A": Key("area of the section", "m²"),
        "Iy": Key("second moment of area about the section's y", "m⁴"),
        "Iz": Key("second moment of area about the section's z", "m⁴"),
        "J": Key("torsion constant", "m⁴"),
        "up": Key("a direction that lies in the section's x-z plane", "1", "0 0 1"),
    },
    "preset.NAME": {"flexure": Key("tables as [flexure.NAME]")},
    "measurement": {
        "frame": Key("frame of the measured positions: `base`, or `unknown` where the instrument's pose is fitted"),
        "gravity_in": Key("`base`, or `measurement` where gravity is known in the levelled instrument's frame"),
    },
    "instrument.NAME": {
        "kind": Key("kind of reading"),
        "link": Key("the link that it reads"),
        "point": Key("where on the link, in its frame", "m"),
        "point_std": Key("one standard deviation of the point, if it is fitted", "m", "0: fixed"),
        "joint": Key("of an encoder: the joint whose links it is on; of a torque: the joint of the drive"),
        "seen_from": Key("of a relative position: the link of the camera"),
        "anchor_link": Key("of a distance: the link that the other end is on", default="the base"),
        "reads": Key("the sign of an accelerometer's reading, or of a torque: what the `drive` exerts, or its `load`"),
        "mode": Key(
            "of a frequency: the number of the mode, 1 is the slowest", default="found by `axis`, else nearest"
        ),
        "axis": Key("of a frequency: direction in the tip frame along which the mode moves the tip", "1"),
        "ratio": Key("of a torque: turns of the motor per turn of the joint, or rad per m", "1 or rad/m", "1"),
        "site": Key("of a force or moment: the joint of the load cell, `base` or `tool`"),
        "friction": Key("of a torque: what the drive exerts more after moving in the positive direction", "Nm"),
        "friction_std": Key("one standard deviation of that", "Nm", "0: fixed"),
        "anchor": Key("the other end of a distance, or the camera, in the frame of its link", "m"),
        "length_offset": Key("offset of the reading of a distance", "m"),
        "scale": Key("relative error of the reading", "1"),
        "scale_std": Key("one standard deviation of that", "1", "0: fixed"),
        "mounting": Key("how it is turned on its link: rotation vector", "rad"),
        "bias": Key("offset of the reading", "as the reading"),
        "anchor_std": Key("one standard deviation of the anchor, if it is fitted", "m", "0: fixed"),
        "length_offset_std": Key("one standard deviation of the distance's zero", "m", "0: fixed"),
        "sigma": Key("one standard deviation of a reading", "as the reading"),
        "place": Key("of a touch: where sockets are whose places are known, by name, in the base", "m", "unknown"),
        "place_std": Key("one standard deviation of those", "m", "0.001"),
        "distances": Key('of a touch: known lengths between sockets, `[["one", "other", length], ..]`', "m"),
        "distance_sigma": Key("one standard deviation of those", "m", "1e-4"),
        "shape": Key("of a touch: `point`, `plane` or `sphere`, by the socket's name", default="`point`"),
        "radius": Key("of a touch: of each sphere, the touching ball's in it", "m"),
        "normal": Key("of a touch: about that of each plane, in the base", "1", "0 0 1"),
        "mounting_std": Key("one standard deviation of how it is turned on the link", "rad", "0: fixed"),
        "bias_std": Key("one standard deviation of the offset", "as the reading", "0: fixed"),
    },
    "prior": {
        "joint_offset": Key("zero of every joint", "rad or m", "0: fixed"),
        "compliance": Key("every declared linear compliance, relative", "1", "0: fixed"),
        "young": Key(
            "one factor on the compliance of every part of `armflex fem`, relative; its own `young_std` comes first",
            "1",
            "0: fixed",
        ),
        "tool": Key("the target's place in the tip frame", "m", "0: fixed"),
        "geometry": Key("every fixed transform of the chain", "m and rad", "0: fixed"),
        "mass": Key("mass and moments of inertia of every moving link, relative", "1", "0: fixed"),
        "payload_mass": Key("those of every payload that the campaign carries, relative", "1", "0: fixed"),
        "session_target": Key(
            "the target's place in the tip frame if it is remounted in each session", "m", "0: fixed"
        ),
        "session_translation": Key("the instrument's frame between sessions", "m", "0: fixed"),
        "session_rotation": Key("the instrument's frame between sessions", "rad", "0: fixed"),
        "each": Key(
            "mean and standard deviation of single parameters by name, as `armflex prior` writes them", "theirs"
        ),
    },
    "effect": {
        "name": Key("a law of the catalogue, or `unnamed`"),
        "shape": Key("of an `unnamed` effect: its form"),
        "site": Key("a joint, `base` or `tool`; a link is named by the joint at its end"),
        "axis": Key("dx dy dz rx ry or rz in the site's frame, where the law has one"),
        "partner": Key("second axis, session or payload, where the law has one"),
        "covariates": Key("columns that it depends on, if their names differ from those of the law"),
        "derived": Key("directions `approach_<joint>` that are derived from the order of the rows"),
        "parameters": Key("values by name, see the catalogue of effects", "as listed there"),
        "std": Key("one standard uncertainty of each", "as the parameter's"),
        "seen": Key("range of each covariate in which it was found; outside it a result is flagged", "the covariate's"),
    },
    "effect.parameters": {"NAME": Key("value of the parameter", "as listed in the catalogue")},
    "effect.std": {"NAME": Key("one standard uncertainty", "as the parameter's")},
    "calibration": {
        "unfinished": Key("written while `trace` was still searching"),
        "measurements_sha256": Key("digest of the campaign"),
        "rows": Key("rows that the fit used"),
        "rms_m": Key("RMS of the 3-D position error over these", "m"),
        "instrument": Key("pose of the base in the instrument's frame: shift and rotation vector", "m, rad"),
        "target": Key("the measured target in the tip frame", "m"),
        "scale": Key("share by which the instrument's distances are too long", "1"),
        "mounting": Key("how the target is turned on the tool: rotation vector", "rad"),
        "joint_offset": Key("added to what the controller reports, by joint", "rad or m"),
        "geometry": Key("correction of each fixed transform, by joint: shift and rotation vector", "m, rad"),
        "compliance": Key("logarithms of the factors on each axis' compliance, by flexure", "1"),
        "mass": Key("logarithms of the factors on masses and moments of inertia, by link or `payload NAME`", "1"),
        "sessions": Key("shift and rotation vector of the instrument's frame, by session", "m, rad"),
        "targets": Key("shift and rotation vector of the target on the tool, by session", "m, rad"),
        "campaigns": Key("names of campaigns that were fitted together; their frames are among those of sessions"),
        "sensors": Key("fitted parameters of the instruments other than the tracker, by instrument", "each its own"),
        "law": Key("learned laws, by flexure"),
        "misfit_m": Key("scatter of the readings beyond their stated noise", "m"),
        "design_effect": Key("readings that carry as much information as one independent reading would", "1"),
        "unexplained": Key("where something without a recorded cause acts"),
        "parameters": Key("names of the fitted parameters, in the order of the covariance"),
        "covariance": Key("posterior covariance: rows of the lower triangle", "products of the parameters' units"),
        "covariance_file": Key("the safetensors file that holds it, where it is large"),
        "covariance_sha256": Key("digest of that file"),
        "undetermined": Key("directions in parameter space that neither campaign nor prior determines", "1"),
    },
    "calibration.joint_offset": {"NAME": Key("of this joint", "rad or m")},
    "calibration.geometry": {"NAME": Key("shift and rotation vector before this joint", "m, rad")},
    "calibration.mass": {"NAME": Key("of this link, or `payload NAME`", "1")},
    "calibration.compliance": {"NAME": Key("of this flexure's six axes", "1")},
    "calibration.sessions": {"NAME": Key("of this session", "m, rad")},
    "calibration.targets": {"NAME": Key("of this session", "m, rad")},
    "calibration.unexplained": {
        "site": Key("where it acts"),
        "axis": Key("along or about what"),
        "std": Key("how much it scatters", "m or rad"),
    },
    "calibration.law.NAME": {
        "values": Key("the law's parameters", "each its own"),
        "scales": Key("how large each group of them may be", "each its own"),
        "mean": Key("mean of the observed loads", "N, Nm"),
        "precision": Key("of the observed loads", "1/N², …"),
        "loads": Key("smallest and largest observed load of each component", "N, Nm"),
        "load_scale": Key("unit of the loads in the law", "N, Nm"),
        "twist_scale": Key("unit of the twists in the law", "m, rad"),
        "reach": Key("deflection up to which the correction goes", "m, rad"),
        "faded": Key("distance beyond the observed loads at which the correction has faded", "1"),
        "energy": Key("the distance that it fades by", "1/N², …"),
    },
}
"""Table -> key -> meaning."""

_ROW = {
    "time": Key("when: from any origin", "s", "the row's number"),
    "payload": Key("a payload of the arm.toml", default="`none`, also where the cell is empty"),
    "q_JOINT": Key(
        "the controller's position of every moving joint of the chain; of joints beside it, as of a second arm, where "
        "they move: their weight then loads the common links",
        "rad or m",
        "**required** of the chain; beside it, where `[robot] locked` holds it",
    ),
    "approach_JOINT": Key("-1, 0 or +1: the way the joint last moved", "", "from the order of the rows"),
    "force_fx": Key("known force from outside", "N", "0"),
    "force_fy": Key("the same along y", "N", "0"),
    "force_fz": Key("the same along z", "N", "0"),
    "force_mx": Key("known moment from outside", "Nm", "0"),
    "force_my": Key("the same about y", "Nm", "0"),
    "force_mz": Key("the same about z", "Nm", "0"),
    "force_frame": Key("the link at whose origin the load acts", default="the tip"),
    "force_axes": Key("`link` or `base`: whose axes the load is in", default="`base`"),
}

COLUMNS: dict[str, dict[str, Key]] = {
    "measurements.csv": {
        "pose": Key("identifier; repeats of a commanded pose share it", default="the row's number"),
        "session": Key("identifier; the instrument may stand elsewhere in another one", default="one session"),
        **_ROW,
        "x": Key("measured position of the target; empty where the arm went and nothing was read", "m"),
        "y": Key("the same", "m"),
        "z": Key("the same", "m"),
        "rx": Key("measured orientation: rotation vector, about x", "rad", "not measured"),
        "ry": Key("the same, about y", "rad", "not measured"),
        "rz": Key("the same, about z", "rad", "not measured"),
        "sigma": Key("one standard deviation of each of x y z", "m"),
        "sigma_x": Key("the same of x alone, instead of `sigma`", "m"),
        "sigma_y": Key("the same of y", "m"),
        "sigma_z": Key("the same of z", "m"),
        "sigma_r": Key("one standard deviation of the orientation", "rad", "needed with rx ry rz"),
        "hold": Key("how long the load has stood", "s", "not known"),
        "target_JOINT": Key("where a compensated path was meant to be; of no meaning here", "rad or m", "not known"),
        "point": Key("with `--points`: name of the row's point in that file", default="`pose`"),
    },
    "trajectory.csv": {
        **_ROW,
        "via": Key("name of the via-point that the row is", default="none"),
        "v_JOINT": Key("joint velocities, of every joint, where inertial loads count", "rad/s or m/s", "slow"),
        "a_JOINT": Key("joint accelerations, of every joint", "rad/s² or m/s²", "slow"),
        "target_JOINT": Key(
            "joint positions, of every joint, that put the rigid tip where the flexed one is to be",
            "rad or m",
            "`q_JOINT`",
        ),
    },
    "joint_data.csv": {
        **{f"f{axis}": Key(f"force on the joint along {axis}", "N") for axis in "xyz"},
        **{f"m{axis}": Key(f"moment on the joint about {axis}", "Nm", "forces alone") for axis in "xyz"},
        **{f"d{axis}": Key(f"deflection along {axis}", "m") for axis in "xyz"},
        **{f"r{axis}": Key(f"deflection about {axis}", "rad", "shifts alone") for axis in "xyz"},
    },
}
"""File -> column -> meaning. JOINT stands for a joint's name."""
