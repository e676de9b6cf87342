"""The gyral graph: where crests of gyri run and meet, the hinges there, and how far they may be trusted."""
