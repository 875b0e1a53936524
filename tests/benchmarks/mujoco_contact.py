"""How far the exported MuJoCo model is from the kernel in a drop: the same springs, another contact law.

    python tests/benchmarks/mujoco_contact.py

Three models of each drop: the kernel; the exported MuJoCo model, whose contact is set to the identified
spring (`sysid.export.mjcf`); and the same with MuJoCo's default contact (solref 0.02 1, solimp 0.9 0.95), as
a model written by hand would have it. On low friction also the exported model without MuJoCo's friction, with
that of equation (8) as a force on its feet at steps of 20 µs: what is left is not friction.

Printed: mean NRMSE over x, z, pitch and the rates of x and z in the first 0.1 s and in 0.7 s, against the
kernel. Bounces are chaotic: after several contacts differences grow.
"""

import argparse
import math
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np

from paired import mean_nrmse
from sysid.export.mjcf import to_mjcf
from sysid.export.published import table_2
from sysid.gear.model import PARAMETERS, simulate

DROPS = (("lf", 15.0, 0.8), ("lf", 30.0, 0.5), ("hf", 10.0, 0.5), ("hf", 20.0, 0.7))
CLOCK = np.arange(0, 0.7005, 1e-3)


def values(surface):
    """Table II's means, without what is no parameter of the model."""
    return {k: v for k, v in table_2(surface).set_values(1).items() if k in PARAMETERS}


def default_contact(document):
    """The same model with MuJoCo's own contact parameters."""
    root = ElementTree.fromstring(document)
    for pair in root.iter("pair"):
        for key in ("solref", "solreffriction", "solimp"):
            del pair.attrib[key]
    del root.find("option").attrib["impratio"]
    return ElementTree.tostring(root)


def drop(document, speed):
    """Five channels of a drop from the document's touchdown, without thrust."""
    model = mujoco.MjModel.from_xml_string(document.decode())
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = 0
    data.qvel[1] = -speed
    every = round((CLOCK[1] - CLOCK[0]) / model.opt.timestep)
    out = np.empty((len(CLOCK), 5))
    for n in range(len(CLOCK)):
        out[n] = [*data.qpos[:3], *data.qvel[:2]]
        mujoco.mj_step(model, data, every)
    return out


def with_our_friction(document, slope, speed, p):
    """The same with friction (8) as an applied force; the normal force stays MuJoCo's."""
    model = mujoco.MjModel.from_xml_string(document.decode().replace('condim="3"', 'condim="1"'))
    model.opt.timestep = 2e-5
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = 0
    data.qvel[1] = -speed
    up = np.array([math.sin(slope), 0, math.cos(slope)])
    down = np.array([math.cos(slope), 0, -math.sin(slope)])
    feet = [model.geom(f"{end}_foot") for end in ("rear", "front")]
    every = round((CLOCK[1] - CLOCK[0]) / model.opt.timestep)
    out, jacobian = np.empty((len(CLOCK), 5)), np.zeros((3, model.nv))
    for n in range(len(CLOCK) * every):
        if n % every == 0:
            out[n // every] = [*data.qpos[:3], *data.qvel[:2]]
        mujoco.mj_step1(model, data)
        data.qfrc_applied[:] = 0
        for foot in feet:
            depth = foot.size[0] - data.geom_xpos[foot.id] @ up
            if depth > 0:
                point = data.geom_xpos[foot.id] - foot.size[0] * up
                mujoco.mj_jac(model, data, jacobian, None, point, foot.bodyid[0])
                slip = jacobian @ data.qvel @ down
                share = slip / (abs(slip) + p["slip_regularization"])
                force = -p["kinetic_friction"] * p["ground_stiffness"] * depth * share
                data.qfrc_applied += jacobian.T @ (force * down)
        mujoco.mj_step2(model, data)
    return out


def kernel(surface, slope, speed):
    """The same from the kernel."""
    p = values(surface)
    z = (p["foot_dx"] * math.sin(slope) + p["foot_dz"] * math.cos(slope)) / math.cos(slope)
    state = simulate(p, slope, [0, z, 0, 0, -speed, 0], CLOCK, surface=surface, tolerance=1e-7).state
    return state[:, [0, 1, 2, 7, 8]]


def main():
    """Print the table."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    print("drop               exported 0.1 s   0.7 s     MuJoCo's default 0.1 s   0.7 s   our friction 0.7 s")
    for surface, slope_deg, speed in DROPS:
        slope = math.radians(slope_deg)
        document = to_mjcf(values(surface), sticks=surface == "hf", slope=slope)
        exact = kernel(surface, slope, speed)
        shares = [
            100 * mean_nrmse(model[rows], exact[rows])
            for model in (drop(document, speed), drop(default_contact(document), speed))
            for rows in (until + 1e-9 >= CLOCK for until in (0.1, 0.7))
        ]
        name = f"{surface.upper()} {slope_deg:g} deg {speed:g} m/s"
        ours = ""
        if surface == "lf":
            forced = with_our_friction(document, slope, speed, values(surface))
            ours = f"{100 * mean_nrmse(forced, exact):12.1f} %"
        print(
            f"{name:<18} {shares[0]:12.2f} % {shares[1]:6.1f} % {shares[2]:22.2f} % {shares[3]:6.1f} % {ours}"
        )


if __name__ == "__main__":
    main()
