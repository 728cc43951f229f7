"""Measuring in images: photos in, pixels out. NumPy and OpenCV, no JAX. (0, 0) is a pixel's centre."""

from jaxmocap.vision.beads import BeadCandidates as BeadCandidates
from jaxmocap.vision.beads import find_beads as find_beads
from jaxmocap.vision.board_advice import NearDuplicates as NearDuplicates
from jaxmocap.vision.board_advice import advise_board as advise_board
from jaxmocap.vision.board_advice import near_duplicates as near_duplicates
from jaxmocap.vision.board_grid import check_board as check_board
from jaxmocap.vision.board_grid import consistent_order as consistent_order
from jaxmocap.vision.board_grid import orient_by_colour as orient_by_colour
from jaxmocap.vision.chessboard import CornerResult as CornerResult
from jaxmocap.vision.chessboard import find_corners as find_corners
from jaxmocap.vision.chessboard import refine_corners as refine_corners
from jaxmocap.vision.colour import hsb_of_rgb as hsb_of_rgb
from jaxmocap.vision.colour import square_hsb as square_hsb
from jaxmocap.vision.detect_boards import BoardDetections as BoardDetections
from jaxmocap.vision.detect_boards import detect_boards as detect_boards
from jaxmocap.vision.hough import hough_circles as hough_circles
from jaxmocap.vision.hough import opencv_circles as opencv_circles
from jaxmocap.vision.photo_list import expand_photos as expand_photos
from jaxmocap.vision.photo_list import natural_key as natural_key
from jaxmocap.vision.photos import Photo as Photo
from jaxmocap.vision.photos import check_same_size as check_same_size
from jaxmocap.vision.photos import read_photo as read_photo
from jaxmocap.vision.threshold import edge_map as edge_map
from jaxmocap.vision.threshold import grey_of as grey_of
from jaxmocap.vision.threshold import mean_threshold as mean_threshold
from jaxmocap.vision.threshold import outline as outline
