"""Where integrations and maps stay right, where they end by name, and how far off they are at the edge."""
