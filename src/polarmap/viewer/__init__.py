"""A map in the browser, while it grows and after (docs/viewing.md).

watcher  what a run tells of itself, to whom it may concern
patch    a keyframe as a piece of surface with colours, and its pictures
stored   the same of a run's folder
page     the page (needs the extra `view`)
feed     a thread between a run and its page, which a run never waits for
"""
