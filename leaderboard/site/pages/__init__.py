"""The pages: functions from the index and some arguments to a `Page`, with no server involved."""
