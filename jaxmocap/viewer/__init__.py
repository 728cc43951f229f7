"""A scene of markers, skeleton, cameras and axis as one page for the browser."""

from jaxmocap.viewer.page import ViewerParts as ViewerParts
from jaxmocap.viewer.page import scene_page as scene_page
from jaxmocap.viewer.page import viewer_parts as viewer_parts
from jaxmocap.viewer.scene import Axis as Axis
from jaxmocap.viewer.scene import CameraView as CameraView
from jaxmocap.viewer.scene import Markers as Markers
from jaxmocap.viewer.scene import Skeleton as Skeleton
from jaxmocap.viewer.scene import ViewerScene as ViewerScene
