"""Video over a tether: the kernels of a codec modelled on H.264; `codec` puts them together.

All arithmetic is in integers, so every processor produces the same bytes. Formulas and tables are those of
ITU-T H.264; a macroblock is 16 x 16 px of luma and 8 x 8 of each colour difference, all coded in blocks of 4 x 4.
"""
