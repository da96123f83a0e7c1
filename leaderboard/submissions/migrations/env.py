"""What alembic runs for every command: over the connection that it was given, in the transaction of that one."""

from __future__ import annotations

from alembic import context

context.configure(connection=context.config.attributes["connection"])
context.run_migrations()
