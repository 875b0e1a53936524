"""The compliant normal force (7) on a foot; friction laws are in `sysid.gear.surfaces`."""

from numba import njit

from sysid.integrate.fused import fused


@njit(error_model="numpy", forceinline=True)
@fused
def normal_force(penetration, penetration_rate, k_s, b_s):
    """Normal force on a foot [N], equation (7): spring always, damper only while the foot goes deeper."""
    damping = b_s * penetration_rate if penetration_rate > 0.0 else 0.0
    return k_s * penetration + damping if penetration > 0.0 else 0.0
