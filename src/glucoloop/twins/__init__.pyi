from .course import Simulator as Simulator
from .days import RecordedDays as RecordedDays
from .days import recorded_days as recorded_days
from .fit import find_twin as find_twin
from .noise import Noise as Noise
from .prior import Prior as Prior
from .prior import prior_of as prior_of
from .twin import Twin as Twin
