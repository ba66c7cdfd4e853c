"""Live manual control: one set of controls, shown in the terminal, in a window or in a browser.

The bench loop stays in the process and thread that a person signals, where every safe stop of it holds. Window and web
server live in a process of their own that only asks and draws: whatever becomes of it (closed, hung, killed), the loop
does not wait for it, notices and brakes.
"""
