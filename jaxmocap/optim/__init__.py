"""Structured least squares: solve, covariance, derivatives through the solution. Knows no camera."""

from jaxmocap.optim.arrow_solver import ArrowDescent as ArrowDescent
from jaxmocap.optim.arrow_solver import ArrowLevenbergMarquardt as ArrowLevenbergMarquardt
from jaxmocap.optim.covariance import ArrowCovariance as ArrowCovariance
from jaxmocap.optim.least_squares import least_squares as least_squares
from jaxmocap.optim.linearise import ArrowProblem as ArrowProblem
from jaxmocap.optim.packing import ArrowVariables as ArrowVariables
