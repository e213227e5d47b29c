"""The only reader of MuJoCo models outside of simulators: joints, actuators, their names and units,
fields, observed columns, contacts, motors, and `RobotSimulator`, the contract of simulators with
such a model.

It imports `core` alone. A room above that needs something of a model gets a function or a field
here, and does not index the model's arrays itself.
"""
