"""Forward and backward frequency sweeps."""

from vibrojax.sweep.frequency_response import FrequencyResponse as FrequencyResponse
