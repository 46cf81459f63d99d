"""Export of transcribed problems as C99: kernels as functions, and the numbers of phases as constants."""
