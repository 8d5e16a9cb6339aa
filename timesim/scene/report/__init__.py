"""What `timesim check` says of a scene: what would be modelled, what is left out, the method, the cost, warnings."""

from timesim.scene.report.description import describe
from timesim.scene.report.warning import warnings_of
