"""Skills by k-means on language and states: what LISA's learned codebook is compared with."""
