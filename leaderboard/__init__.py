"""The leaderboard: published results, their ranking, the site that shows them, and submissions."""
