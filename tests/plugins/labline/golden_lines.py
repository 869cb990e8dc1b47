"""The golden vectors of the hardware page, sections 2.3 and 8.2."""

REQUESTS = [
    (b"$1,HELLO*7613", 1, ("HELLO",)),
    (b"$2,WD,250*FBE8", 2, ("WD", "250")),
    (b"$3,ATT,0,1000,2000*1C32", 3, ("ATT", "0", "1000", "2000")),
    (b"$4,SV,1500,1500,1500,1500*4AEF", 4, ("SV", "1500", "1500", "1500", "1500")),
    (b"$6,SV,2600,1500,1500,1500*569B", 6, ("SV", "2600", "1500", "1500", "1500")),
    (b"$5,STOP*CAEC", 5, ("STOP",)),
    (b"$7,ST*4B3E", 7, ("ST",)),
    (b"$1,HOME*5E91", 1, ("HOME",)),
    (b"$2,MV,12.500,1.000*8CEE", 2, ("MV", "12.500", "1.000")),
    (b"$3,VEL,-0.500*18DB", 3, ("VEL", "-0.500")),
    (b"$4,STR,80*B7C9", 4, ("STR", "80")),
]
REPLIES = [
    (b"$1,OK,HELLO,labservo,1.0,4,0500*6AF3", 1, ("OK", "HELLO", "labservo", "1.0", "4", "0500")),
    (b"$2,OK,WD,250*B1D6", 2, ("OK", "WD", "250")),
    (b"$3,OK,ATT*5B65", 3, ("OK", "ATT")),
    (b"$4,OK,SV*C104", 4, ("OK", "SV")),
    (b"$6,ERR,RANGE,0*7615", 6, ("ERR", "RANGE", "0")),
    (b"$5,OK,STOP*A7A5", 5, ("OK", "STOP")),
    (
        b"$7,OK,ST,0,1500,1500,1500,1500,123456*70D5",
        7,
        ("OK", "ST", "0", "1500", "1500", "1500", "1500", "123456"),
    ),
    (b"$0,EV,WDOG*9CA4", 0, ("EV", "WDOG")),
    (
        b"$0,S,1042,123456789,1.2345,-8388608,0*FFFB",
        0,
        ("S", "1042", "123456789", "1.2345", "-8388608", "0"),
    ),
    (b"$0,S,1043,123469289,1.2470,83412,0*E17F", 0, ("S", "1043", "123469289", "1.2470", "83412", "0")),
]
LINES = [*REQUESTS, *REPLIES]
SERVO_TALK = list(
    zip([line for line, _, _ in REQUESTS[:7]], [line for line, _, _ in REPLIES[:7]], strict=True)
)
"""What a labservo of four channels answers to what, in the page's order."""
