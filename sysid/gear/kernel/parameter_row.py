"""The numbers of one candidate as the drivers read them: a column per name, then what the friction law reads.

The order here is the kernel's alone: `sysid.gear.model` finds every column in the gear's table by its name.
"""

NAMES = (
    "body_mass",
    "body_inertia",
    "gravity",
    "foot_dx",
    "foot_dz",
    "thrust_point_dx",
    "joint_dx",
    "joint_dz",
    "leg_axial_stiffness",
    "leg_axial_damping",
    "leg_bending_stiffness",
    "leg_bending_damping",
    "leg_mass",
    "leg_inertia",
    "leg_mass_fraction",
    "ground_stiffness",
    "ground_damping",
    "front_leg_axial_stiffness_ratio",
    "front_leg_axial_damping_ratio",
    "front_leg_bending_stiffness_ratio",
    "front_leg_bending_damping_ratio",
    "front_leg_mass_ratio",
    "front_leg_inertia_ratio",
)
BODY_MASS = NAMES.index("body_mass")
BODY_INERTIA = NAMES.index("body_inertia")
GRAVITY = NAMES.index("gravity")
FOOT_DX = NAMES.index("foot_dx")
FOOT_DZ = NAMES.index("foot_dz")
THRUST_POINT_DX = NAMES.index("thrust_point_dx")
JOINT_DX = NAMES.index("joint_dx")
JOINT_DZ = NAMES.index("joint_dz")
LEG_AXIAL_STIFFNESS = NAMES.index("leg_axial_stiffness")
LEG_AXIAL_DAMPING = NAMES.index("leg_axial_damping")
LEG_BENDING_STIFFNESS = NAMES.index("leg_bending_stiffness")
LEG_BENDING_DAMPING = NAMES.index("leg_bending_damping")
LEG_MASS = NAMES.index("leg_mass")
LEG_INERTIA = NAMES.index("leg_inertia")
LEG_MASS_FRACTION = NAMES.index("leg_mass_fraction")
GROUND_STIFFNESS = NAMES.index("ground_stiffness")
GROUND_DAMPING = NAMES.index("ground_damping")
AXIAL_STIFFNESS_RATIO = NAMES.index("front_leg_axial_stiffness_ratio")
AXIAL_DAMPING_RATIO = NAMES.index("front_leg_axial_damping_ratio")
BENDING_STIFFNESS_RATIO = NAMES.index("front_leg_bending_stiffness_ratio")
BENDING_DAMPING_RATIO = NAMES.index("front_leg_bending_damping_ratio")
MASS_RATIO = NAMES.index("front_leg_mass_ratio")
INERTIA_RATIO = NAMES.index("front_leg_inertia_ratio")

# The first of at most `LAW_SLOTS` columns that the friction law reads.
LAW_READS = len(NAMES)
LAW_SLOTS = 6
