from .dawn import Dawn as Dawn
from .exercise import Exercise as Exercise
from .rhythm import RHYTHMS as RHYTHMS
from .rhythm import Changes as Changes
from .rhythm import Rhythm as Rhythm
from .rhythm import RhythmComponent as RhythmComponent
from .rhythm import rhythm as rhythm
from .visentin2015 import Visentin2015 as Visentin2015
