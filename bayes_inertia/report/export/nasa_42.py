"""Lines of a spacecraft file of NASA's simulator 42.

42 reads products of inertia as +integral of x y dm and negates them on reading
(`B->I[0][1] *= -1.0` in 42init.c): they are the package's Jxy with the other sign. It integrates
the momentum of each wheel by the motor torque alone, so that the body's inertia leaves the wheels'
spin out. A gyro reads Scale * rate, Scale = 1 + 1e-6 ppm (42sensors.c): Scale = 1 / K.
"""

from __future__ import annotations

from bayes_inertia.report.export.content import ExportedResult, comment_lines, tensor_digits

_SAYS = (
    "Body 0: replace these two lines of SC_*.txt (in SC_*.yml: MOI and POI)",
    "J without the wheels' spin inertia, about the centre of mass",
    "42 negates products of inertia on reading: these have the other sign than Jxy, Jxz, Jyz",
)


def nasa_42_text(result: ExportedResult) -> str:
    """The lines of moments and products of inertia, and of the gyros' scale factor errors.

    Returns: lines of the file; what is not of 42 begins with an exclamation mark.
    """
    digits = tensor_digits(result, result.inertia_B)
    turned = tensor_digits(result, -result.inertia_B)
    moments = "  ".join(digits[i][i] for i in range(3))
    products = "  ".join(turned[i][j] for i, j in ((0, 1), (0, 2), (1, 2)))
    gyros = [
        f"{1e6 * (1.0 / result.parameter(f'K{i + 1}').new - 1.0):<40.1f}!  "
        f"Scale Factor Error, ppm (Gyro Axis {i})"
        for i in range(3)
    ]
    return "\n".join(
        [
            *(f"! {line}" for line in comment_lines(result, *_SAYS)),
            f"{moments:<40}!  Moments of Inertia (kg-m^2)",
            f"{products:<40}!  Products of Inertia (xy,xz,yz)",
            *gyros,
            "",
        ]
    )
