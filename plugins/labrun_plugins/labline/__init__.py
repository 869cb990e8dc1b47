"""The line protocol "labline" v1 between labrun and its microcontroller boards: one ASCII line a message.

``$<seq>,<word>[,<arg>...]*<CRC4>`` and a newline, 115 200 baud 8N1. `codec` and `session` are the host's side; `device`
and `board` are the boards' side, for emulators, and share nothing with it.
"""
