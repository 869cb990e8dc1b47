"""Golden vectors of the FT300's line: from its manuals, checked there against pymodbus and minimalmodbus."""


def frame(text: str) -> bytes:
    return bytes.fromhex(text)


WRENCH_COUNTS = (1234, -5678, 10_000, 1234, -567, 2000)
"""12.34, -56.78, 100.00 N; 1.234, -0.567, 2.000 N m."""

READS = {
    (180, 1): frame("09 03 00 B4 00 01 C5 64"),
    (180, 6): frame("09 03 00 B4 00 06 84 A6"),
    (190, 3): frame("09 03 00 BE 00 03 64 A7"),
    (500, 3): frame("09 03 01 F4 00 03 44 8D"),
    (510, 4): frame("09 03 01 FE 00 04 25 4D"),
    (514, 1): frame("09 03 02 02 00 01 25 3A"),
}
WRENCH_REPLY = frame("09 03 0C 04 D2 E9 D2 27 10 04 D2 FD C9 07 D0 90 89")
START = frame("09 10 01 9A 00 01 02 02 00 CD CA")
STARTED = frame("09 10 01 9A 00 01 21 52")
START_BY_06 = frame("09 06 01 9A 02 00 A8 31")

STREAM = {
    WRENCH_COUNTS: frame("20 4E D2 04 D2 E9 10 27 D2 04 C9 FD D0 07 4D C3"),
    (0, 0, 0, 0, 0, 0): frame("20 4E 00 00 00 00 00 00 00 00 00 00 00 00 62 AF"),
    (20_000, 0, 0, 0, 0, 0): frame("20 4E 20 4E 00 00 00 00 00 00 00 00 00 00 82 39"),
}
ALIASING = STREAM[20_000, 0, 0, 0, 0, 0]
