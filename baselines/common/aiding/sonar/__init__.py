"""An imaging sonar as odometry: fans as images of the ground, registered on a chart of it."""

from oysterbench_baselines.common.aiding.sonar.ground import Ground
from oysterbench_baselines.common.aiding.sonar.sensor import Sonar
from oysterbench_baselines.common.aiding.sonar.settings import SonarSettings

__all__ = ["Ground", "Sonar", "SonarSettings"]
