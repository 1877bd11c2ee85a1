from .dawn import Dawn as Dawn
from .exercise import Exercise as Exercise
from .protocol import Changes as Changes
from .protocol import Rhythm as Rhythm
from .settings import RHYTHMS as RHYTHMS
from .settings import RhythmComponent as RhythmComponent
from .settings import rhythm as rhythm
from .visentin2015 import Visentin2015 as Visentin2015
