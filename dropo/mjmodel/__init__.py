"""The only reader of MuJoCo models outside of simulators: joints, actuators, their names and units,
fields, options, observed columns, and `RobotSimulator`, the contract of simulators with such a
model. `files` has what reads and writes models, `dynamics` the forces.

It imports `core` alone. A room above that needs something of a model gets a function or a field
here, and does not index the model's arrays itself.
"""

from dropo.mjmodel.warnings import leave_no_log_file

leave_no_log_file()
