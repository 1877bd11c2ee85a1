from .catalogue import MEASURES as MEASURES
from .catalogue import numbers_of as numbers_of
from .episodes import GlucoseEpisode as GlucoseEpisode
from .episodes import glucose_episodes as glucose_episodes
from .profile import DayProfile as DayProfile
from .profile import day_profile as day_profile
from .series import Readings as Readings
