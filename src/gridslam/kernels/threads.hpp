// Work that is shared among threads which wait for the next.
#pragma once
#include <atomic>
#include <exception>
#include <functional>

namespace gridslam {

// Runs work in this thread and in up to `others` more at once, and waits for them. The threads are kept; a process that
// was forked starts its own. Where another thread of the process has them at work, or no more can be had, fewer take
// part.
void run_in_threads(int others, const std::function<void()>& work);

// Runs body(i) for i in [0, n), which threads take one by one; throws again what a body has thrown first. Each i writes
// only what belongs to it, so the number of threads cannot change a result.
template <class Body>
void parallel_for(int n, int threads, const Body& body) {
  if (threads > n) threads = n;
  if (threads <= 1) {
    for (int i = 0; i < n; ++i) body(i);
    return;
  }
  std::atomic<int> next{0};
  std::atomic<bool> has_failed{false};
  std::exception_ptr failure;
  run_in_threads(threads - 1, [&] {
    try {
      for (int i; (i = next.fetch_add(1)) < n;) body(i);
    } catch (...) {
      next = n;
      if (!has_failed.exchange(true)) failure = std::current_exception();
    }
  });
  if (has_failed) std::rethrow_exception(failure);
}

}  // namespace gridslam
