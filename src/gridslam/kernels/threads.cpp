// Threads that are kept: to start one takes some 15 us, to wake it less, and one that still looks out begins at once.
#include "threads.hpp"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <system_error>
#include <thread>

#if defined(__unix__) || defined(__APPLE__)
#include <pthread.h>
#endif

namespace gridslam {
namespace {

constexpr auto kLookOut = std::chrono::microseconds(20);

class Pool {
 public:
  void run(int others, void (*work)(void*), void* context) {
    if (busy_.exchange(true, std::memory_order_acquire)) {
      work(context);
      return;
    }
    grow(others);
    work_ = work, context_ = context;
    finished_.store(0, std::memory_order_relaxed);
    const int wanted = std::min(others, workers_);
    seats_.store(wanted);
    ++round_;
    if (asleep_ > 0) {
      {
        const std::lock_guard lock(mutex_);
      }  // whoever is about to sleep is asleep by now
      wake_.notify_all();
    }
    work(context);
    const int joined = wanted - seats_.exchange(0);  // who comes later has nothing to do
    while (finished_.load(std::memory_order_acquire) < joined) std::this_thread::yield();
    busy_.store(false, std::memory_order_release);
  }

 private:
  void grow(int others) {
    try {
      for (; workers_ < others; ++workers_) std::thread([this, seen = round_.load()] { serve(seen); }).detach();
    } catch (const std::system_error&) {
      return;
    }
  }

  void serve(uint64_t seen) {
    while (true) {
      seen = next_round(seen);
      for (int seats = seats_.load(); seats > 0;)
        if (seats_.compare_exchange_weak(seats, seats - 1)) {
          work_(context_);
          finished_.fetch_add(1, std::memory_order_release);
          break;
        }
    }
  }

  uint64_t next_round(uint64_t seen) {
    const auto until = std::chrono::steady_clock::now() + kLookOut;
    while (std::chrono::steady_clock::now() < until)
      for (int i = 0; i < 64; ++i)
        if (const uint64_t round = round_.load(std::memory_order_relaxed); round != seen) return round_.load();
    std::unique_lock lock(mutex_);
    ++asleep_;
    wake_.wait(lock, [&] { return round_ != seen; });
    --asleep_;
    return round_;
  }

  std::atomic<bool> busy_{false};
  std::atomic<uint64_t> round_{0};
  std::atomic<int> seats_{0}, finished_{0}, asleep_{0};
  int workers_ = 0;
  void (*work_)(void*) = nullptr;
  void* context_ = nullptr;
  std::mutex mutex_;
  std::condition_variable wake_;
};

// Never destroyed: its threads end with the process.
std::atomic<Pool*> the_pool{nullptr};

Pool& pool() {
  Pool* present = the_pool.load(std::memory_order_acquire);
  if (present != nullptr) return *present;
#if defined(__unix__) || defined(__APPLE__)
  static const int forked = pthread_atfork(nullptr, nullptr, [] { the_pool.store(nullptr); });  // its threads are gone
  static_cast<void>(forked);
#endif
  Pool* fresh = new Pool;
  if (the_pool.compare_exchange_strong(present, fresh, std::memory_order_acq_rel)) return *fresh;
  delete fresh;
  return *present;
}

}  // namespace

void run_in_threads(int others, void (*work)(void*), void* context) { pool().run(others, work, context); }

}  // namespace gridslam
