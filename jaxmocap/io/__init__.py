"""Files: rigs, OpenCV calibrations, tables, JSON; whole or not at all, read with every mistake named."""

from jaxmocap.io.atomic import write_bytes as write_bytes
from jaxmocap.io.atomic import write_many as write_many
from jaxmocap.io.atomic import write_text as write_text
from jaxmocap.io.camera_numbers import NamedCamera as NamedCamera
from jaxmocap.io.json_file import json_bytes as json_bytes
from jaxmocap.io.json_file import write_json as write_json
from jaxmocap.io.opencv_yaml import opencv_yaml_text as opencv_yaml_text
from jaxmocap.io.opencv_yaml import read_opencv_yaml as read_opencv_yaml
from jaxmocap.io.opencv_yaml import write_opencv_yaml as write_opencv_yaml
from jaxmocap.io.rig_file import RigFile as RigFile
from jaxmocap.io.rig_file import rig_text as rig_text
from jaxmocap.io.rig_file import write_rig as write_rig
from jaxmocap.io.rig_reading import read_rig as read_rig
from jaxmocap.io.tables import Correspondences as Correspondences
from jaxmocap.io.tables import Observations as Observations
from jaxmocap.io.tables import read_correspondences as read_correspondences
from jaxmocap.io.tables import read_observations as read_observations
from jaxmocap.io.tables import table_text as table_text
from jaxmocap.io.tables import write_table as write_table
from jaxmocap.io.text_file import hash_files as hash_files
