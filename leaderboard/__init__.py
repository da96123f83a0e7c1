"""The leaderboard: published results, their order, the site that shows them, and how to submit."""
