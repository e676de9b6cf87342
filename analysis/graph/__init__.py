"""The gyral graph: the crests of gyri, the hinges where they meet, and the confidence of the hinges."""
