"""Human motion: read from many formats into one skeleton, judged and corrected before retargeting."""
