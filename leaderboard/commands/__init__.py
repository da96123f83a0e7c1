"""The commands of `oysterbench leaderboard`."""
