"""Model files the tests share."""

OSCILLATOR = """
name = "oscillator"
states = ["angle", "rate"]
inputs = ["torque"]
[parameters]
inertia   = { value = 2.0, tolerance = 0.1, unit = "kg m^2" }
stiffness = { value = 50.0, unit = "N m/rad" }
damping   = { value = 0.8, unit = "N m s/rad" }
[equations]
angle = "rate"
rate  = "(torque + force.hinge - stiffness*angle - damping*rate) / inertia"
[outputs]
angle  = "angle"
torque = "torque"
spring = "stiffness*angle - force.hinge"
[sites.hinge]
kind = "joint"
coordinate = "angle"
rate = "rate"
stiffness = "stiffness"
load = "10*angle"
[initial]
angle = "first"
rate = 0.0
"""

PENDULUM = """
name = "pendulum"
states = ["angle", "rate"]
[parameters]
frequency_squared = 9.0
damping = 0.3
[equations]
angle = "rate"
rate  = "-frequency_squared*sin(angle) - damping*rate"
[outputs]
angle = "angle"
energy = "rate^2/2 - frequency_squared*cos(angle)"
"""

FOLLOWER = """
name = "follower"
states = ["y"]
inputs = ["u"]
[parameters]
tau = 0.5
[equations]
y = "(u - y)/tau"
[outputs]
y = "y"
"""
