from .breton_2008 import Breton2008 as Breton2008
from .dexcom_g5 import DexcomG5 as DexcomG5
from .dexcom_g6 import DexcomG6 as DexcomG6
from .display import Display as Display
from .facchinetti_2014 import Facchinetti2014 as Facchinetti2014
from .model import ErrorModel as ErrorModel
from .monitor import Monitor as Monitor
from .vettoretti_2019 import Vettoretti2019 as Vettoretti2019
