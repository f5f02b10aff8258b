"""The command line: reads arguments and files, calls the library, prints.

`cli` names the commands; `files` reads what they are given, `inspection`, `judging` and `reports` put together what
they say, `tables` prints it; `live` and `demo` are sessions.
"""

__all__: list[str] = []
