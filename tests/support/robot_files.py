"""Robots in other formats than URDF: a crane for MuJoCo with every kind of joint."""

MJCF = """<mujoco model="crane">
  <compiler angle="degree" autolimits="true"/>
  <default><joint armature="0.1" damping="3"/><geom type="capsule" size="0.05"/></default>
  <worldbody>
    <geom type="plane" size="3 3 0.1"/>
    <body name="mast" pos="0.1 0 0.5" quat="0.9 0.1 -0.2 0.3">
      <joint name="slew" axis="0 0.2 2" range="-170 170" actuatorfrcrange="-900 900"/>
      <inertial pos="0.1 0.02 0.3" mass="40" diaginertia="2 3 1.5" quat="0.7 0.1 0.7 0"/>
      <body name="boom" pos="0.3 0 0.8" euler="10 20 0">
        <joint name="luff" axis="0 1 0" pos="-0.1 0 0.05" ref="15" range="-60 75"/>
        <joint name="roll" axis="1 0 0" pos="0.2 0.1 0"/>
        <geom fromto="0 0 0 1.2 0 0.1" mass="22"/>
        <body name="slide" pos="1.2 0 0.1">
          <joint name="reach" type="slide" axis="1 0 0.1" ref="0.05" range="-0.2 0.9"/>
          <geom fromto="0 0 0 0.7 0 0" mass="9"/>
          <body name="hook" pos="0.7 0 0" axisangle="0 1 0 30">
            <inertial pos="0 0 -0.1" mass="4" diaginertia="0.02 0.02 0.02"/>
            <site name="tcp_site" pos="0 0.03 -0.2" euler="0 0 45"/>
          </body>
        </body>
        <body name="lamp" pos="0.5 0 0.1">
          <joint name="lid" axis="0 1 0" range="0 20"/><geom type="sphere" mass="1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="luff" gear="100" forcerange="-3 3"/></actuator>
</mujoco>
"""
