"""Reports of calibrations: a self-contained page, a notebook card, and the summary on the command line."""

from jaxmocap.report.data import CalibrationReport as CalibrationReport
from jaxmocap.report.data import CameraReport as CameraReport
from jaxmocap.report.data import ParameterRow as ParameterRow
from jaxmocap.report.data import ViewReport as ViewReport
from jaxmocap.report.failure import failure_html as failure_html
from jaxmocap.report.html import calibration_html as calibration_html
from jaxmocap.report.html import card_html as card_html
from jaxmocap.report.text import format_value as format_value
from jaxmocap.report.text import summary_text as summary_text
from jaxmocap.report.turntable import TurntableReport as TurntableReport
from jaxmocap.report.turntable import turntable_html as turntable_html
from jaxmocap.report.turntable import turntable_summary as turntable_summary
