"""What the paper claims, what we found, and how we read it."""

CLAIMS = """
A loosely coupled GNSS/INS filter whose noise covariances tune themselves, from the residuals and
innovations of a moving window, detects slow spoofing ramps that the common filter of fixed noise
misses, and finds the others ten times sooner. Both raise an alarm where the normalized innovation
squared exceeds 25.9, chi-square of three degrees of freedom at a false-alarm probability of 1e-5.
Table 1 gives the time to the first alarm for ramps of 2, 3 and 5 m/s to the east and to the
north: none, 3.41 and 1.91 s for the common filter; 0.35, 0.22 and 0.11 s for the self-tuning one.
It is one simulated run of 30 s, attacked from 20 to 25 s; false alarms are not measured.
"""

FINDINGS = """
**The self-tuning filter's times of table 1 are met, under one condition that the paper does not
state**: errors of GNSS have to be correlated. With a first-order Gauss-Markov process of 1.6 m
(horizontal) and 3 m (vertical) and a decay of 0.999 an epoch, the default of the simulation toolbox
that the paper names, windows of 30 to 100 epochs give medians of 0.3-0.4, 0.2 and 0.1 s. What
matters is the noise from one epoch to the next, 0.07 m, which the tuning finds. With a decay of
0.99 a ramp of 2 m/s is seen in a quarter of the runs, with 0.9 in a thirtieth.

**Under the white noise that the stated R describes, the order reverses**: the common filter sees
all ramps of 5 m/s, the self-tuning one about one in twenty, and an offset that has grown to
0.7 m (0.35 s of 2 m/s) cannot be seen in white noise of 3.7 m at 1e-5. Table 1 contradicts the
stated R.

**The common filter's times** need another R: with correlated errors and the stated one, only the
ramp of 5 m/s is detected, after 4.2 s. R times 0.24 to 0.28, which we fitted, gives 3.5 to 4.0 s
and 1.7 to 1.8 s at 3 and 5 m/s, for the printed 3.41 and 1.91 s, and nothing at 2 m/s; no such
factor brings both within the spread of single runs. White errors of 1.6 m and 3 m with R times 0.4,
fitted too, do so, but hide the ramps from the self-tuning filter.

**The gain is a smaller R, not tuning.** A common filter that simply assumes 0.37 m instead of 3.7
m detects all ramps, after 0.9, 0.55 and 0.33 s, without a false alarm in the first 15 s, and is
above the threshold in 60 to 90 % of the epochs from 25 to 30 s, in which the offset stays. The
alarm of the self-tuning filter passes: after a second or two the window takes the attack for
noise, and from 25 to 30 s there is next to none.

**False alarms are 15 to 10,000 times as many as stated**, since S is itself estimated from w
epochs: 1e-1 of all epochs for w = 5, 2e-2 for 10, 1e-3 for 30, 2e-4 for 100. With Hotelling's
threshold for an estimated covariance (30.1 for w = 100 instead of 25.9) the stated rate is kept
where errors are white, and exceeded two to four times where they are correlated, since they are
then neither white nor independent of their window. For w = 100 this costs next to nothing; for w
= 30 it costs most detections at 2 and 3 m/s. So w = 100 and that threshold are the defaults of
`spoofgym/LooselyCoupled-v0`.

**The adaptation of Q is unstable.** Under correlated errors the ratio under the root becomes
negative some dozen times in a run; taken as 0, Q is 0 for ever after in every run. With any rule
that keeps it alive, Q wanders over many orders of magnitude, and under the white noise for which
the stated Q is right it grows by a factor of 1e3 (w = 100) to 1e6 (w = 10). It does not change
latencies. It is an option, `process`, and off.

**Averaging** N epochs done right, as a sum against chi-square of 3 N, helps the common filter
more than tuning does: under white noise, N = 10 raises the share detected at 2 m/s from 5 to
80 %.
"""

READINGS = """
- **GNSS errors**: first-order Gauss-Markov, 1.6 m horizontal, 3 m vertical, decay 0.999 at 10 Hz
  ("correlated" below). The paper names a toolbox and no settings. "White" is noise of the stated
  R.
- **Inertial errors**: white noise and biases of just the size that the filter assumes; initial
  errors of the stated size before the factor 3 of the initial covariance.
- **Flight**: recorded and not named; ours has its speed (200 m/s east, 50 m/s north), 160 Hz, a
  climb and two gentle turns.
- **States** in metres. The paper's R, Q and P are in metres, its position errors in radians.
- **F** as in the appendix, but for row 2 of F13 (v_E, not v_N), F33 (no factor v x), and the
  gradient of gravity. Its linear propagation explains the drift of our noise-free INS to 0.2 mm
  rms in 30 s.
- **R** takes effect one epoch later: it needs the estimate of its own epoch. Entered into the
  test of the same epoch, a residual hides itself (rows "with itself"). Until the window is full,
  the stated R stays.
- **N = 1**: 25.9 is chi-square of 3 degrees. The paper's mean over N epochs has neither 3 nor its
  stated 3 (N + 1) degrees.
- **Q** fixed in all rows, unless stated otherwise.
- **Latency** from 20 s to the first epoch with an alarm, up to 5 s. Epochs are 0.1 s apart; the
  paper's 0.35, 0.22 and 0.11 s are not on that grid. Medians over the runs that detect.
- **After 25 s** the offset stays at its last value.
- **Shares.** The paper shows one run of every ramp; a share of 1 stands for a detection in it, 0
  for none.
"""
