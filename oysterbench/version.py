"""The version of the library, and of everything it writes."""

VERSION = "0.1.0"
