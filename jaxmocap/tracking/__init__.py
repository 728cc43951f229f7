"""Which bead is which: colours, tracks across photographs, names."""

from jaxmocap.tracking.bead_colours import BeadColours as BeadColours
from jaxmocap.tracking.bead_colours import learn_colours as learn_colours
from jaxmocap.tracking.identification import Identification as Identification
from jaxmocap.tracking.identification import identify_beads as identify_beads
from jaxmocap.tracking.tpose import TPoseColours as TPoseColours
from jaxmocap.tracking.tpose import colours_from_tpose as colours_from_tpose
