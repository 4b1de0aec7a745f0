// Work that is shared among threads which wait for the next.
#pragma once
#include <atomic>
#include <exception>

namespace gridslam {

// Runs work(context) in this thread and in up to `others` more at once, and waits for them. The threads are kept: they
// wait actively for some 20 us, then asleep; a process that was forked starts its own. Where another thread of the
// process has them at work, or no more can be had, fewer take part.
void run_in_threads(int others, void (*work)(void*), void* context);

// The numbers from 0 to n - 1, which threads take one by one until none is left. An exception ends the loop.
class SharedLoop {
 public:
  explicit SharedLoop(int n) : n_(n) {}
  // Runs body(i) for numbers that no other thread has taken.
  template <class Body>
  void work(const Body& body) noexcept {
    try {
      for (int i; (i = next_.fetch_add(1, std::memory_order_relaxed)) < n_;) body(i);
    } catch (...) {
      next_.store(n_);
      if (!has_failed_.exchange(true)) failure_ = std::current_exception();
    }
  }
  // Throws again what a body has thrown first; call it when all threads have ended.
  void rethrow() const {
    if (has_failed_) std::rethrow_exception(failure_);
  }

 private:
  const int n_;
  std::atomic<int> next_{0};
  std::atomic<bool> has_failed_{false};
  std::exception_ptr failure_{};
};

// Runs body(i) for i in [0, n). Each i writes only what belongs to it, so the number of threads cannot change a result.
template <class Body>
void parallel_for(int n, int threads, const Body& body) {
  if (threads > n) threads = n;
  if (threads <= 1) {
    for (int i = 0; i < n; ++i) body(i);
    return;
  }
  struct Shared {
    const Body& body;
    SharedLoop loop;
  } shared{body, SharedLoop(n)};
  run_in_threads(
      threads - 1,
      [](void* context) {
        Shared& s = *static_cast<Shared*>(context);
        s.loop.work(s.body);
      },
      &shared);
  shared.loop.rethrow();
}

// Work that goes on in another thread while the one that asks for it does something else. That thread is kept, and
// takes one piece of work after the other.
class BackgroundWork {
 public:
  // Has work(context) run once, before `end` returns or never.
  BackgroundWork(void (*work)(void*), void* context);
  ~BackgroundWork() { end(); }
  BackgroundWork(const BackgroundWork&) = delete;
  BackgroundWork& operator=(const BackgroundWork&) = delete;
  // Waits until the work has ended; what has not begun never does.
  void end();

 private:
  friend class BackgroundThread;
  void (*work_)(void*);
  void* context_;
};

}  // namespace gridslam
