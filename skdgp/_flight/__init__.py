"""Flight data: what the columns of a log are, what is wrong with them, and the filters and axes that all use.

Names and units of channels (``channels.py``) and the clock (``clock.py``) make the checked table of
flights (``tables.py``). The numbers of a log are checked in this order: units
(``units.py``, whose ``check_flight`` is the door of inverse dynamics), faults of single channels
(``faults.py``), slower clocks (``holds.py``), and the physics that relates channels (``physics``). Smoothing,
the band of the motion, frames and the position of the sensors are used by all that follow.
"""
