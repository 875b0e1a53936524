"""The numbers of one candidate as the drivers read them: a column per name, then what the friction law reads.

The order here is the kernel's alone: `sysid.gear.model` finds every column in the gear's table by its name.
"""

# fmt: off
(
    BODY_MASS, BODY_INERTIA, GRAVITY, FOOT_DX, FOOT_DZ, THRUST_POINT_DX, JOINT_DX, JOINT_DZ,
    LEG_AXIAL_STIFFNESS, LEG_AXIAL_DAMPING, LEG_BENDING_STIFFNESS, LEG_BENDING_DAMPING,
    LEG_MASS, LEG_INERTIA, LEG_MASS_FRACTION, GROUND_STIFFNESS, GROUND_DAMPING,
    FRONT_LEG_AXIAL_STIFFNESS_RATIO, FRONT_LEG_AXIAL_DAMPING_RATIO, FRONT_LEG_BENDING_STIFFNESS_RATIO,
    FRONT_LEG_BENDING_DAMPING_RATIO, FRONT_LEG_MASS_RATIO, FRONT_LEG_INERTIA_RATIO,
    LEG_AXIAL_HARDENING, LEG_BENDING_HARDENING, LEG_SLIDE_FRICTION, LEG_JOINT_FRICTION,
    GROUND_RATE_STIFFENING, PITCH_DRAG,
) = range(29)
# fmt: on

# The rows of the gear's table: the names above, in their order.
NAMES = tuple(name.lower() for name in list(globals()) if name.isupper())

# The first of the columns that only `sysid.gear.kernel.terms` reads.
FIRST_TERM = LEG_AXIAL_HARDENING
TERMS = len(NAMES) - FIRST_TERM

# The first of at most `LAW_SLOTS` columns that the friction law reads.
LAW_READS = len(NAMES)
LAW_SLOTS = 6
