"""Model files with bodies on hinges that the tests share."""

PENDULUMS = """
name = "two-pendulums"
gravity_m_s2 = [0, 0, -9.81]
[parameters]
mass = { value = 0.4, unit = "kg" }
spring = { value = 0.5, unit = "N m/rad" }
[inputs]
push = { unit = "N m" }
[bodies.frame]
fixed = true
[bodies.upper]
mass_kg = "mass"
center_m = [0.02, 0, -0.1]
inertia_kg_m2 = [2e-3, 3e-3, 4e-3, 2e-4, -1e-4, 3e-4]
[bodies.lower]
mass_kg = 0.3
center_m = [0, 0.01, -0.35]
inertia_kg_m2 = [1e-3, 1e-3, 5e-4]
[joints.shoulder]
from = "frame"
to = "upper"
axis = [0, 1, 0]
torque_n_m = "push"
[joints.elbow]
from = "upper"
to = "lower"
axis = [1, 0.5, 0]
at_m = [0, 0, -0.25]
stiffness_n_m_rad = "spring"
damping_n_m_s_rad = 0.01
rest_rad = 0.1
[outputs]
shoulder = "shoulder"
elbow = "elbow"
energy = "kinetic_energy_j + potential_energy_j"
"""
"""Two pendulums on axes that are not parallel: a tree without a loop."""

PARALLELOGRAM = """
name = "parallelogram"
gravity_m_s2 = [0, 0, -9.81]
[parameters]
crank = { value = 0.2, tolerance = 0.0, unit = "m", lower = 0.01 }
width = { value = 0.3, tolerance = 0.0, unit = "m", lower = 0.01 }
friction = { value = 0.0, unit = "N m s/rad", lower = 0.0 }
[bodies.frame]
fixed = true
[bodies.left]
mass_kg = 0.1
center_m = [0, 0, "-crank/2"]
inertia_kg_m2 = [3e-4, 3e-4, 1e-5]
[bodies.right]
mass_kg = 0.1
center_m = [0, 0, "-crank/2"]
inertia_kg_m2 = [3e-4, 3e-4, 1e-5]
[bodies.coupler]
mass_kg = 0.5
center_m = ["width/2", 0, 0]
inertia_kg_m2 = [1e-5, 4e-3, 4e-3]
[joints.left]
from = "frame"
to = "left"
axis = [0, 1, 0]
damping_n_m_s_rad = "friction"
[joints.right]
from = "frame"
to = "right"
axis = [0, 1, 0]
at_m = [0.3, 0, 0]
at_in_to_m = [0, 0, 0]
[joints.pin]
from = "left"
to = "coupler"
axis = [0, 1, 0]
at_m = [0, 0, "-crank"]
at_in_to_m = [0, 0, 0]
[joints.close]
from = "right"
to = "coupler"
axis = [0, 1, 0]
at_m = [0, 0, -0.2]
at_in_to_m = ["width", 0, 0]
[loop]
joint = "close"
[outputs]
left = { equation = "left", unit = "rad" }
open = { equation = "max(loop_angle_rad, loop_distance_m)" }
energy = "kinetic_energy_j + potential_energy_j"
[initial]
left = 0.6
"""
"""A four-bar linkage with equal cranks: the coupler keeps its direction, and all of it swings as one pendulum."""
