# SPDX-License-Identifier: Apache-2.0
"""A URDF of an arm with two joints, whose mesh is in a package that is nowhere."""

BODY = (
    '<inertial><mass value="2"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.025"/></inertial>'
    '<visual><geometry><mesh filename="package://nowhere/arm.stl"/></geometry></visual>'
)
JOINT = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="0.1 0 0.2"/>'
    '<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="3" effort="{3}"/></joint>'
)
URDF = (
    f'<robot name="arm"><link name="base"/><link name="upper">{BODY}</link><link name="fore">{BODY}</link>'
    f"{JOINT.format('shoulder', 'base', 'upper', 60)}{JOINT.format('elbow', 'upper', 'fore', 40)}</robot>"
)
