"""Landings simulated with identified sets: scenarios, controllers, outcomes, maps (section III of the paper).

Consumes ranked parameter sets (`sysid.parameter_sets`) of a gear and of a motor, and nothing else.
"""
