from .kinds import (
    PLANTS as PLANTS,
    Plant as Plant,
    PlantPart as PlantPart,
    find_plant as find_plant,
    read_plant as read_plant,
)
from .lagged import LAGGED as LAGGED
from .turtlesim import TURTLESIM as TURTLESIM, Turtle as Turtle
