"""One form of a rounded number: of the terminal, the report and sentences."""

import ast
import re
from pathlib import Path

import pytest

import tissueid
from tissueid.digits import number, plain_exponents, power_of_ten, together, typeset, with_error

PACKAGE = Path(tissueid.__file__).parent


@pytest.mark.parametrize(
    ("values", "sd", "expected"),
    [
        ([0.0209, 0.0193, 0.0225], 0.0008, ["0.02090", "0.01930", "0.02250"]),
        ([4.0, 3.1, 4.9], 0.45, ["4.00", "3.10", "4.90"]),
        ([1.2e-5, 1.1e-5, 1.3e-5], 5e-7, ["1.200×10⁻⁵", "1.100×10⁻⁵", "1.300×10⁻⁵"]),
        ([-2.0e-7, 4.0e-7], 3e-7, ["−2.0×10⁻⁷", "4.0×10⁻⁷"]),
        ([1.1e-15, 0.0, 7.4e-13], 2e-13, ["0", "0", "7.4×10⁻¹³"]),
        ([12345.6, 11900.0], 321.0, ["12346", "11900"]),
        ([3.0], None, ["3.000"]),
        # no zero has a sign, or a power of ten
        ([105.0, -0.2, 209.0], 62.0, ["105", "0", "209"]),
        ([0.0, 0.0, 1.4e-13], 0.78, ["0.00", "0.00", "0.00"]),
        ([0.0, 0.0, 1.322e-9], 5e-7, ["0", "0", "1.322×10⁻⁹"]),
    ],
)
def test_a_value_and_its_interval_end_at_the_place_that_the_interval_supports(values, sd, expected) -> None:
    assert together(values, sd) == expected


@pytest.mark.parametrize("exponent", [-12, -5, 3, 27])
def test_a_power_of_ten_can_be_read_back(exponent: int) -> None:
    assert plain_exponents(f"1.5{power_of_ten(exponent)}") == f"1.5x10^{exponent}"


@pytest.mark.parametrize(
    ("value", "digits", "expected"),
    [
        (63.6249, 4, "63.62"),
        (0.021, 3, "0.0210"),
        (-5.5, 2, "−5.5"),
        (0.0, 4, "0"),
        (-0.0, 4, "0"),
        (571614.0, 3, "571614"),
        (1.25e-7, 3, "1.25×10⁻⁷"),
        (float("inf"), 4, "inf"),
        (None, 4, "–"),
    ],
)
def test_numbers_are_written_as_people_write_them(value: float | None, digits: int, expected: str) -> None:
    assert number(value, digits) == expected


@pytest.mark.parametrize(
    ("value", "stderr", "expected"),
    [
        (63.6212, 0.891, "63.62 ± 0.89"),
        (0.0210041, 0.000312, "0.02100 ± 0.00031"),
        (1234.0, 56.0, "1234 ± 56"),
        (12340.0, 560.0, "12340 ± 560"),
        (5.0, None, "5.000"),
        (None, 0.1, "not identified"),
        (5.174e-6, 1.12e-7, "(5.17 ± 0.11)×10⁻⁶"),
        (-5.174e-6, 1.12e-7, "(−5.17 ± 0.11)×10⁻⁶"),
        (0.1461059, 5.1e-6, "0.1461059 ± 0.0000051"),
        (-0.001, 0.1, "0.00 ± 0.10"),
    ],
)
def test_a_value_ends_where_its_error_ends(value: float | None, stderr: float | None, expected: str) -> None:
    assert with_error(value, stderr) == expected


@pytest.mark.parametrize(
    ("computed", "shown"),
    [
        ("noise 1.2e-05 N, p = 3e-12", "noise 1.2×10⁻⁵ N, p = 3×10⁻¹²"),
        ("(1e-11 to 1e-08 m2/s)", "(10⁻¹¹ to 10⁻⁸ m2/s)"),
        ("a step of 1.23e+03 N", "a step of 1230 N"),
        ("-4.5e+07 Pa", "-4.5×10⁷ Pa"),
        ("run_1e-05.csv [1e-05b]", "run_1e-05.csv [1e-05b]"),
        ("2e-05.csv", "2e-05.csv"),
    ],
)
def test_computed_exponents_are_raised_and_names_are_left_alone(computed: str, shown: str) -> None:
    assert typeset(computed) == shown


def test_nobody_else_writes_a_power_of_ten_or_an_error() -> None:
    """A second form of the same number would show two values where there is one."""
    own = re.compile(r"×10\^|\.split\(\"e\"\)")
    for file in PACKAGE.rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        if file.name == "digits.py":
            continue
        assert not own.search(text), file
        names = {one.name for one in ast.walk(ast.parse(text)) if isinstance(one, ast.FunctionDef)}
        assert not names & {"with_error", "together", "power_of_ten"}, file
