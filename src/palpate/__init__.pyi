from . import classifiers as classifiers
from . import encodings as encodings
from . import evaluation as evaluation
from . import exploration as exploration
from . import images as images
from . import library as library
from . import recognition as recognition
from . import sensors as sensors
from . import simulation as simulation
from . import touches as touches
from .evaluation import evaluate as evaluate
from .exploration import explore as explore
from .library import TouchLibrary as TouchLibrary
from .recognition import Belief as Belief
from .recognition import Evidence as Evidence
from .recognition import ObjectRecogniser as ObjectRecogniser
from .sensors import open_sensor as open_sensor
from .simulation import simulate_presses as simulate_presses
from .simulation import simulate_touches as simulate_touches
from .touches import Touches as Touches

__version__: str
