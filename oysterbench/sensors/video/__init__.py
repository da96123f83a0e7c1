"""Video over a tether: a codec after H.264, kernel by kernel; `codec` puts them together.

All arithmetic is in whole numbers, so that every processor makes the same bytes. Formulas and tables are those of
ITU-T H.264; a macroblock is 16 x 16 px of luma and 8 x 8 of each colour difference, all coded in blocks of 4 x 4.
"""
