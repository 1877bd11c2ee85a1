from .nightscout_site import read_nightscout as read_nightscout
from .readers import READERS as READERS
from .readers import ReaderComponent as ReaderComponent
from .record import DeviceRecord as DeviceRecord
from .record import FileRefusal as FileRefusal
from .record import read_record as read_record
