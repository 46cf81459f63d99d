"""Parameters from data: maximum likelihood by multiple shooting."""
