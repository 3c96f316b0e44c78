"""The engine: one text in C of where an arm rests and how its tip responds, with its tables and its calls.

`engine.c` is compiled when the package is built, see `build`; `tables` checks all that it reads, `binding` calls it.

**A chain** comes to rest by a fixed point. Everything is written in the base's axes about the rigid arm: flexing
flexure k moves all that is outboard of it by the screw `s_k = Ad(T_k) t_k`, with T_k the flexure's pose in the rigid
arm, because

    J1 exp(t1) J2 exp(t2) ... = exp(s1) exp(s2) ... J1 J2 ...

A screw, v and w at the flexure's origin o, moves a point x by `u + b w x u + c w x (w x u)` with `u = v + w x (x - o)`;
b and c are the exponential's, as series: they hold for turns up to 0.1 rad. Some configurations go side by side, in
packs of as many numbers as the processor's registers hold; a controller has the same text for one. Neurons are asked at
the loads on the rigid arm, and are moved on from there.

**Loops and springs** come to rest by Newton's method, about the base's origin. The coordinates z are positions of
passive joints and y of laws R y, R S' = C; each moves all that its element carries by a spatial twist s. A closure gaps
by `W (V2 - V1)` of the twists of its ends, its forces f put the wrench W'f on its first end and minus that on the
second. With A = W s, F the load on all that an element carries and G the change of -s F with z, every step solves

    | 1_y + G   A' | | dz |   | s F - y |
    |   A      -D  | | df | = |  -gap   |      D: a unit for what nothing answers to

without G in the first step, with it as it was there from the second on.

**It stays** where 1_y + Z' G Z is positive along the motions Z that its loops allow, by coordinate of laws. A norm of
Z' G Z below 1 is a proof, as Cholesky's factor is. With V the twists of elements, G is

    Z' G Z = - sum_k (V x s) . F - sum_bodies V . dw + sum_ties (V2 - V1) . dh

w what acts on a body and h the wrench of a tie as they move with them. One pass out and one back make that linear in a
twist that is inserted anywhere, which is all that there is to know of how a tip responds.
"""
