"""The command line of the platform: sets up, builds, brings systems up, runs the demonstration.

It may import any package of the tree; nothing in the tree imports it (tests do). Modules that run
before the set-up is complete use the standard library only: `terminal`, `paths`, `provision`,
`workspace`, `environment`, `processes`.
"""
