"""The words of a command line as this system's shell hands them to a program."""

import ctypes
import os
import shlex


def words_of(line):
    if os.name != "nt":
        return shlex.split(line)
    count, split = ctypes.c_int(), ctypes.windll.shell32.CommandLineToArgvW
    split.restype = ctypes.POINTER(ctypes.c_wchar_p)
    return split(line, ctypes.byref(count))[: count.value]
