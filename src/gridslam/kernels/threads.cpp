// Threads that are kept: to start one takes some 15 us, to wake it less, and one that still looks out begins at once.
#include "threads.hpp"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
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

}  // namespace

class BackgroundThread {
 public:
  void add(BackgroundWork* work) {
    const std::lock_guard lock(mutex_);
    try {
      if (!is_started_) std::thread([this] { serve(); }).detach();
    } catch (const std::system_error&) {
      return;
    }
    is_started_ = true;
    waiting_.push_back(work);
    wake_.notify_one();
  }

  void end(BackgroundWork* work) {
    std::unique_lock lock(mutex_);
    std::erase(waiting_, work);
    ended_.wait(lock, [&] { return running_ != work; });
  }

  void end_all() {
    std::unique_lock lock(mutex_);
    ended_.wait(lock, [&] { return waiting_.empty() && running_ == nullptr; });
  }

 private:
  void serve() {
    std::unique_lock lock(mutex_);
    while (true) {
      wake_.wait(lock, [&] { return !waiting_.empty(); });
      running_ = waiting_.front();
      waiting_.pop_front();
      lock.unlock();
      running_->work_(running_->context_);
      lock.lock();
      running_ = nullptr;
      ended_.notify_all();
    }
  }

  std::mutex mutex_;
  std::condition_variable wake_, ended_;
  std::deque<BackgroundWork*> waiting_;
  BackgroundWork* running_ = nullptr;
  bool is_started_ = false;
};

namespace {

// Never destroyed: their threads end with the process.
std::atomic<Pool*> the_pool{nullptr};
std::atomic<BackgroundThread*> the_background{nullptr};

// What a fork leaves behind: the work has ended, and the threads are gone.
void watch_forks() {
#if defined(__unix__) || defined(__APPLE__)
  const auto before = [] {
    if (BackgroundThread* background = the_background.load()) background->end_all();
  };
  const auto in_child = [] { the_pool.store(nullptr), the_background.store(nullptr); };
  static const int watched = pthread_atfork(before, nullptr, in_child);
  static_cast<void>(watched);
#endif
}

// The present one of its kind, made where there is none.
template <class Kind>
Kind& of_this_process(std::atomic<Kind*>& one) {
  Kind* present = one.load(std::memory_order_acquire);
  if (present != nullptr) return *present;
  watch_forks();
  Kind* fresh = new Kind;
  if (one.compare_exchange_strong(present, fresh, std::memory_order_acq_rel)) return *fresh;
  delete fresh;
  return *present;
}

}  // namespace

void run_in_threads(int others, void (*work)(void*), void* context) {
  of_this_process(the_pool).run(others, work, context);
}

BackgroundWork::BackgroundWork(void (*work)(void*), void* context) : work_(work), context_(context) {
  of_this_process(the_background).add(this);
}

void BackgroundWork::end() { of_this_process(the_background).end(this); }

}  // namespace gridslam
