"""The only reader of MuJoCo models outside of simulators: joints, actuators, names, units, fields,
observed columns, contacts, motors.

It also holds `RobotSimulator`, the contract of simulators that have such a model. It may import
`core` alone. What rooms above want to know of a model is a function or a field here, not an index
into its arrays there.
"""
