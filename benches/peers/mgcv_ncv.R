# Neighbourhood cross-validation by mgcv of a linear model without smooths; mgcv_ncv.py starts it, and says why so.
# Reads folders, a line each, and answers with seconds of the fit and of the evaluation, after it wrote the predictions.
suppressMessages(library(mgcv))
if (!exists("C_Rncv", asNamespace("mgcv"))) quit(status = 1)
numbers <- function(name, what, n) readBin(file.path(folder, name), what, n, size = if (what == "integer") 4 else 8)
evaluate <- function(A, b, nei, fit, threads) {
  none <- matrix(0, 1, 0)
  predicted <- numeric(length(nei$i))  # written by the routine
  .Call(mgcv:::C_Rncv, A, fit$R, fit$e, rep(1, length(b)), matrix(0, ncol(A), 0), matrix(0, length(b), 0), list(),
        nei$i - 1L, nei$mi, nei$m, nei$k - 1L, fit$x, numeric(0), predicted, none, matrix(0, 1, 1), 0L,
        .Machine$double.eps, threads)
  predicted
}
cat("mgcv", as.character(packageVersion("mgcv")), "in R", as.character(getRversion()), "\n")
flush(stdout())
lines <- file("stdin", "r")
while (length(folder <- readLines(lines, 1)) > 0) {
  size <- numbers("sizes", "integer", 6)
  A <- matrix(numbers("A", "double", size[1] * size[2]), size[1])
  b <- numbers("b", "double", size[1])
  nei <- list(k = numbers("k", "integer", size[4]) + 1L, m = numbers("m", "integer", size[3]),
              i = numbers("i", "integer", size[5]) + 1L, mi = numbers("mi", "integer", size[3]))
  start <- Sys.time()
  R <- chol(crossprod(A))
  x <- as.vector(backsolve(R, backsolve(R, crossprod(A, b), transpose = TRUE)))
  fit <- list(R = R, x = x, e = as.vector(b - A %*% x))
  middle <- Sys.time()
  predicted <- evaluate(A, b, nei, fit, size[6])
  end <- Sys.time()
  if (size[1] * size[2] <= 20000 && size[3] > 100) {  # what the routine gives is what users of gam get
    nei <- c(nei, list(a = nei$k, ma = nei$m, d = nei$i, md = nei$mi))  # as later versions call them
    whole <- gam(b ~ A - 1, paraPen = list(A = list(diag(ncol(A)), sp = 1e-14)), method = "NCV", nei = nei)
    stopifnot(abs(sum((b[nei$i] - predicted)^2) / whole$gcv.ubre - 1) < 1e-6)
  }
  writeBin(predicted, file.path(folder, "predicted"))
  cat(as.numeric(difftime(middle, start, units = "secs")), as.numeric(difftime(end, middle, units = "secs")), "\n")
  flush(stdout())
}
