from .model import ErrorModel as ErrorModel
from .monitor import Display as Display
from .monitor import Monitor as Monitor
from .published import Breton2008 as Breton2008
from .published import DexcomG5 as DexcomG5
from .published import DexcomG6 as DexcomG6
from .published import Facchinetti2014 as Facchinetti2014
from .published import Vettoretti2019 as Vettoretti2019
