"""What every refinement returns: a value, its covariance, a result code in a sentence, and how it got there."""

from typing import Any

import equinox as eqx
import optimistix as optx
from jaxtyping import PyTree

from jaxmocap._errors import SolveError


class RESULTS(optx.RESULTS):  # type: ignore[misc]
    """Result codes; the sentence of a code is `RESULTS[code]`, empty for success."""

    successful = ""
    not_finite_at_start = (
        "The residuals are not finite at the start values. Likely causes: (a) NaN or infinity in the observations, "
        "(b) a start value with a point exactly in a camera centre. Mask the observations or give another start."
    )
    out_of_steps = (
        "The solver used all its steps without settling. Likely causes: (a) start values far from the solution, "
        "(b) parameters that the data do not determine, so that the cost has a long flat valley. Freeze parameters "
        "(--distortion none), add views, or allow more steps."
    )
    stalled = (
        "No step of any length lowers the cost although the gradient is not zero. Likely causes: (a) residuals that "
        "jump (a mask that depends on the unknowns), (b) a point on the wrong side of a camera. Give another start."
    )
    undetermined = (
        "The data do not determine all free parameters: the normal equations are singular, and the covariance is "
        "infinite. Freeze parameters, or add observations (of a calibration: views that differ more)."
    )
    too_few_observations = (
        "There are fewer observations than free parameters. Add views or points, or freeze parameters."
    )


class Estimate(eqx.Module):
    """A refined quantity with its uncertainty.

    Source: mission of the project: one covariance from pixels to joint angles.
    """

    value: PyTree
    """The estimate, in the shape of the start value."""
    covariance: Any
    """Covariance of the free parameters (see optim.covariance.ArrowCovariance); None if not asked for."""
    result: RESULTS
    """A code; `sentence` spells it out."""
    stats: dict[str, Any]
    """`cost` (half the sum of squares), `steps`, `cost_history`, `damping_history`, `residual_variance`, ..."""

    @property
    def success(self) -> bool:
        """True if the solve settled on a determined optimum."""
        return bool(self.result == RESULTS.successful)

    @property
    def sentence(self) -> str:
        """What happened, in words; "Converged." on success."""
        return RESULTS[self.result] or "Converged."

    def check(self) -> "Estimate":
        """This estimate, or SolveError with the sentence if the solve failed."""
        if not self.success:
            raise SolveError(self.sentence)
        return self
