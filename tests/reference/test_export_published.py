"""The published parameter sets: current, equal to what is printed, and good enough to simulate with."""

import numpy as np
import pytest

from fakes.places import PUBLISHED
from fakes.published import table_1, table_2, write_published
from sysid.report.set_tables import mean_table

NAMES = ["published-gear-hf.json", "published-gear-lf.json", "published-motor.json"]

# Tables I and II as printed (mm and kg·m² as there), beside the SI numbers of the module.
PRINTED_2 = {
    "joint_dx": (1e-3, "88±5", "67±1"),
    "joint_dz": (1e-3, "24±8", "19±7"),
    "leg_axial_stiffness": (1.0, "6440±599", "6670±350"),
    "leg_axial_damping": (1.0, "14.3±4.6", "20.3±1.3"),
    "leg_bending_stiffness": (1.0, "10.5±0.3", "3.44±0.4"),
    "leg_bending_damping": (1.0, "0.056±0.045", "0.017±0.005"),
    "ground_stiffness": (1e5, "1.10±0.07", "1.49±0.1"),
    "ground_damping": (1.0, "0.042±0.01", "0.058±0.036"),
    "leg_mass": (1.0, "", "0.015±0.004"),
    "leg_inertia": (1e-4, "", "2.1±1.7"),
    "kinetic_friction": (1.0, "", "0.87±0.11"),
    "static_friction_excess": (1.0, "", "0.08±0.07"),
}


def test_files_are_current(tmp_path):
    write_published(tmp_path)
    assert sorted(p.name for p in PUBLISHED.glob("*.json")) == NAMES
    for name in NAMES:
        same = (PUBLISHED / name).read_bytes() == (tmp_path / name).read_bytes()
        assert same, f"{name} is not current: run python tests/fakes/published.py"


def test_table_two_as_printed():
    rows = {row.record.name: row for row in mean_table(table_2("lf"), table_2("hf"))}
    assert len(rows) == 16
    for name, (unit, *columns) in PRINTED_2.items():
        for cell, text in zip(rows[name].fitted, columns, strict=True):
            if not text:
                assert cell is None
            else:
                # The same decimal number, once scaled here and once typed in SI.
                printed = [float(part) * unit for part in text.split("±")]
                assert [cell.mean, cell.sigma] == pytest.approx(printed, rel=1e-12)
    assert rows["body_mass"].measured == (1.242,)
    assert rows["body_inertia"].measured == (0.0137,)
    assert rows["foot_dx"].measured == (0.105,)
    assert rows["foot_dz"].measured == (0.151,)
    assert rows["leg_axial_stiffness"].measured == (5600.0, 6600.0)
    assert rows["leg_mass"].measured == (0.02,)
    assert rows["leg_inertia"].measured == (2.0e-4,)
    assert rows["kinetic_friction"].measured == (0.44,)


def test_table_one_with_its_slip_named():
    sets = table_1()
    values = sets.set_values()
    printed = {
        "winding_resistance": 0.299,
        "winding_inductance": 0.0038,
        "viscous_damping": 9.2e-9,
        "rotor_inertia": 2.7e-5,
        "saturation_current": 0.35,
        "saturation_speed": 6.3,
    }
    assert {name: values[name] for name in printed} == printed
    assert values["back_emf_constant"] == values["torque_constant"] == 0.00995
    # 960 rpm/V, to the three digits given.
    assert values["back_emf_constant"] == pytest.approx(60 / (2 * np.pi * 960), abs=5e-6)
    sources = {record.name: record.source for record in sets.parameters}
    assert "0.099" in sources["torque_constant"]
    assert "not printed" in sources["thrust_quadratic_forward"]
    assert float(sets.nrmse[0]) == 0.0267
