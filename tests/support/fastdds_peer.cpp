// A program on another vendor's DDS (eProsima Fast DDS), as a robot on rmw_fastrtps would be: it drives through a room of
// 10 m x 6 m with a pillar, publishes scans and transforms, joins late to get the latched map, and tells as JSON what it
// got. Messages are written and read by Fast CDR, field by field. Then it reads the graph of nodes, and calls services: a
// request has the GUID of the reader of replies as its related identity, and the reply has that and the request's number.
//
// Usage: fastdds_peer DOMAIN SCANS [SERVICE PACKAGE TYPE REQUEST]...   REQUEST: hexadecimal bytes of CDR

#include <fastcdr/Cdr.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <map>
#include <string>
#include <thread>
#include <vector>

namespace fdds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;
using Bytes = std::vector<char>;

// A type of messages that are kept as their bytes.
struct Kind : fdds::TopicDataType {
  explicit Kind(const char *name) {
    setName(name);
    m_typeSize = 1 << 16;
    m_isGetKeyDefined = false;
    auto_fill_type_information(false);
    auto_fill_type_object(false);
  }
  bool serialize(void *data, rtps::SerializedPayload_t *out) override {
    const Bytes &bytes = *static_cast<Bytes *>(data);
    std::memcpy(out->data, bytes.data(), bytes.size());
    out->length = bytes.size();
    out->encapsulation = CDR_LE;
    return true;
  }
  bool deserialize(rtps::SerializedPayload_t *in, void *data) override {
    static_cast<Bytes *>(data)->assign(in->data, in->data + in->length);
    return true;
  }
  std::function<uint32_t()> getSerializedSizeProvider(void *data) override {
    return [data] { return static_cast<uint32_t>(static_cast<Bytes *>(data)->size()); };
  }
  void *createData() override { return new Bytes; }
  void deleteData(void *data) override { delete static_cast<Bytes *>(data); }
  bool getKey(void *, rtps::InstanceHandle_t *, bool) override { return false; }
};

struct Peer {
  fdds::DomainParticipant *participant;
  fdds::Publisher *publisher;
  fdds::Subscriber *subscriber;

  explicit Peer(int domain) {
    fdds::DomainParticipantQos qos;
    auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    udp->interfaceWhiteList.push_back("127.0.0.1");
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(udp);
    rtps::Locator_t local;
    rtps::IPLocator::setIPv4(local, "127.0.0.1");
    qos.wire_protocol().builtin.initialPeersList.push_back(local);
    participant = fdds::DomainParticipantFactory::get_instance()->create_participant(domain, qos);
    publisher = participant->create_publisher(fdds::PUBLISHER_QOS_DEFAULT);
    subscriber = participant->create_subscriber(fdds::SUBSCRIBER_QOS_DEFAULT);
  }

  fdds::Topic *topic(const char *name, const char *kind) {
    fdds::TypeSupport(new Kind(kind)).register_type(participant);
    return participant->create_topic(name, kind, fdds::TOPIC_QOS_DEFAULT);
  }

  template <class Qos>
  static void set(Qos &qos, bool reliable, bool latched, int depth) {
    qos.reliability().kind = reliable ? fdds::RELIABLE_RELIABILITY_QOS : fdds::BEST_EFFORT_RELIABILITY_QOS;
    qos.durability().kind = latched ? fdds::TRANSIENT_LOCAL_DURABILITY_QOS : fdds::VOLATILE_DURABILITY_QOS;
    qos.history().kind = fdds::KEEP_LAST_HISTORY_QOS;
    qos.history().depth = depth;
    qos.endpoint().history_memory_policy = rtps::DYNAMIC_RESERVE_MEMORY_MODE;
  }

  fdds::DataWriter *writer(const char *name, const char *kind, bool reliable, bool latched) {
    fdds::DataWriterQos qos;
    set(qos, reliable, latched, 100);
    qos.reliable_writer_qos().times.heartbeatPeriod = eprosima::fastrtps::Duration_t(0, 100000000);  // not 3 s
    return publisher->create_datawriter(topic(name, kind), qos);
  }

  fdds::DataReader *reader(fdds::Topic *topic, bool latched, int depth) {
    fdds::DataReaderQos qos;
    set(qos, true, latched, depth);
    return subscriber->create_datareader(topic, qos);
  }
};

// Writes one message.
struct Writing {
  FastBuffer buffer;
  Cdr cdr{buffer, Cdr::LITTLE_ENDIANNESS, Cdr::DDS_CDR};
  Writing() { cdr.serialize_encapsulation(); }
  void header(int64_t stamp_ns, const std::string &frame) {
    cdr << static_cast<int32_t>(stamp_ns / 1000000000) << static_cast<uint32_t>(stamp_ns % 1000000000) << frame;
  }
  void send(fdds::DataWriter *writer) {
    Bytes bytes(buffer.getBuffer(), buffer.getBuffer() + cdr.getSerializedDataLength());
    writer->write(&bytes);
  }
};

void send_transform(fdds::DataWriter *writer, int64_t stamp_ns, const char *parent, const char *child, double x, double y,
                    double yaw) {
  Writing message;
  message.cdr << static_cast<uint32_t>(1);
  message.header(stamp_ns, parent);
  message.cdr << std::string(child) << x << y << 0.0 << 0.0 << 0.0 << std::sin(yaw / 2) << std::cos(yaw / 2);
  message.send(writer);
}

// Distance from a place to the walls and the pillar's near sides, along a direction.
double range(double x, double y, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  double least = c > 0 ? (10 - x) / c : c < 0 ? -x / c : 1e9;
  least = std::min(least, s > 0 ? (6 - y) / s : s < 0 ? -y / s : 1e9);
  const double dx = 7 - x, dy = 4 - y, along = dx * c + dy * s, aside = std::abs(dy * c - dx * s);
  if (along > 0 && aside < 0.4) least = std::min(least, along - std::sqrt(0.16 - aside * aside));
  return least;
}

void send_scan(fdds::DataWriter *writer, int64_t stamp_ns, double x, double y, double yaw) {
  const int beams = 270;
  const float first = -2.35f, step = 4.7f / (beams - 1);
  std::vector<float> ranges, none;
  for (int k = 0; k < beams; k++) ranges.push_back(static_cast<float>(range(x, y, yaw + first + step * k)));
  Writing message;
  message.header(stamp_ns, "laser");
  message.cdr << first << first + step * (beams - 1) << step << 0.0f << 0.05f << 0.05f << 30.0f << ranges << none;
  message.send(writer);
}

template <class Take>
void take_all(fdds::DataReader *reader, Take take) {
  Bytes bytes;
  fdds::SampleInfo info;
  while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK)
    if (info.valid_data) take(bytes);
}

// Header and cells of nav_msgs/OccupancyGrid, as JSON.
std::string described(Bytes &bytes) {
  FastBuffer buffer(bytes.data(), bytes.size());
  Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
  cdr.read_encapsulation();
  int32_t seconds;
  uint32_t nanoseconds, width, height;
  std::string frame;
  float resolution;
  double x, y, rest[5];
  cdr >> seconds >> nanoseconds >> frame >> seconds >> nanoseconds >> resolution >> width >> height >> x >> y;
  cdr.deserializeArray(rest, 5);
  std::vector<int8_t> cells;
  cdr >> cells;
  std::map<int, int> counts;
  for (int8_t cell : cells) counts[cell]++;
  char text[400];
  std::snprintf(text, sizeof text,
                "{\"frame\": \"%s\", \"width\": %u, \"height\": %u, \"resolution\": %.6f, \"origin\": [%.4f, %.4f, %.1f], "
                "\"cells\": %zu, \"unknown\": %d, \"free\": %d, \"occupied\": %d}",
                frame.c_str(), width, height, resolution, x, y, rest[4], cells.size(), counts[-1], counts[0], counts[100]);
  return text;
}

bool matched(fdds::DataWriter *writer, int readers = 1) {
  fdds::PublicationMatchedStatus status;
  return writer->get_publication_matched_status(status) == ReturnCode_t::RETCODE_OK && status.current_count >= readers;
}

template <class True>
bool until(True true_, int seconds = 60) {
  for (int k = 0; k < seconds * 50; k++) {
    if (true_()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  return false;
}

std::string hexadecimal(const Bytes &bytes) {
  std::string text;
  char pair[3];
  for (char byte : bytes) {
    std::snprintf(pair, sizeof pair, "%02x", static_cast<unsigned char>(byte));
    text += pair;
  }
  return text;
}

// What rmw_fastrtps does for a client; hexadecimal bytes of the reply, empty if none comes.
std::string call(Peer &peer, const std::string &service, const std::string &package, const std::string &type,
                 const std::string &request) {
  const std::string kind = package + "::srv::dds_::" + type;
  fdds::DataReader *replies = peer.reader(peer.topic(("rr" + service + "Reply").c_str(), (kind + "_Response_").c_str()), false, 10);
  fdds::DataWriter *writer = peer.writer(("rq" + service + "Request").c_str(), (kind + "_Request_").c_str(), true, false);
  fdds::SubscriptionMatchedStatus status;
  if (!until([&] { return matched(writer) && replies->get_subscription_matched_status(status) == ReturnCode_t::RETCODE_OK &&
                          status.current_count > 0; }, 20))
    return "";
  Bytes bytes;
  for (size_t k = 0; k + 1 < request.size(); k += 2)
    bytes.push_back(static_cast<char>(std::stoi(request.substr(k, 2), nullptr, 16)));
  rtps::WriteParams parameters;
  parameters.related_sample_identity().writer_guid() = replies->guid();
  if (!writer->write(&bytes, parameters)) return "";
  const auto number = parameters.sample_identity().sequence_number();
  std::string reply;
  until([&] {
    Bytes got;
    fdds::SampleInfo info;
    while (replies->take_next_sample(&got, &info) == ReturnCode_t::RETCODE_OK)
      if (info.valid_data && info.related_sample_identity.writer_guid() == replies->guid() &&
          info.related_sample_identity.sequence_number() == number)
        reply = hexadecimal(got);
    return !reply.empty();
  }, 20);
  return reply;
}

int main(int count, char **arguments) {
  const int domain = std::atoi(arguments[1]), scans = std::atoi(arguments[2]);
  Peer peer(domain);
  const char *tf = "tf2_msgs::msg::dds_::TFMessage_", *scan = "sensor_msgs::msg::dds_::LaserScan_";
  const char *grid = "nav_msgs::msg::dds_::OccupancyGrid_";
  fdds::DataWriter *fixed = peer.writer("rt/tf_static", tf, true, true), *moving = peer.writer("rt/tf", tf, true, false);
  fdds::DataWriter *laser = peer.writer("rt/scan", scan, false, false);
  auto *heard = peer.reader(static_cast<fdds::Topic *>(peer.participant->lookup_topicdescription("rt/tf")), false, 1000);
  send_transform(fixed, 0, "base_link", "laser", 0.0, 0.0, 0.0);
  // its own reader hears /tf, too
  if (!until([&] { return matched(fixed) && matched(moving, 2) && matched(laser); })) {
    std::fprintf(stderr, "nobody listens\n");
    return 1;
  }
  double x = 2, y = 2, yaw = 0.3;
  int links = 0;
  for (int k = 0; k < scans || (links < 30 && k < 30 * scans); k++) {  // it stands in the end, until it has heard enough
    const auto now = std::chrono::system_clock::now().time_since_epoch();
    const int64_t stamp_ns = std::chrono::duration_cast<std::chrono::nanoseconds>(now).count();
    send_transform(moving, stamp_ns, "odom", "base_link", x, y, yaw);
    send_scan(laser, stamp_ns, x, y, yaw);
    if (k < scans) x += 0.03 * std::cos(yaw), y += 0.03 * std::sin(yaw), yaw += 0.005;
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
    take_all(heard, [&](Bytes &bytes) {
      FastBuffer buffer(bytes.data(), bytes.size());
      Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
      cdr.read_encapsulation();
      uint32_t count, nanoseconds;
      int32_t seconds;
      std::string parent, child;
      cdr >> count >> seconds >> nanoseconds >> parent >> child;
      links += parent == "map" && child == "odom";
    });
  }
  std::string found;
  fdds::DataReader *late = peer.reader(peer.topic("rt/map", grid), true, 1);
  until([&] {
    take_all(late, [&](Bytes &bytes) { found = described(bytes); });
    return !found.empty();
  });
  std::string graph;
  fdds::DataReader *nodes =
      peer.reader(peer.topic("ros_discovery_info", "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"), true, 1);
  until([&] {
    take_all(nodes, [&](Bytes &bytes) { graph = hexadecimal(bytes); });
    return !graph.empty();
  }, 20);
  std::string replies;
  for (int k = 3; k + 3 < count; k += 4) {
    const std::string reply = call(peer, arguments[k], arguments[k + 1], arguments[k + 2], arguments[k + 3]);
    replies += std::string(replies.empty() ? "" : ", ") + "\"" + arguments[k] + "\": \"" + reply + "\"";
  }
  std::printf("{\"links\": %d, \"map\": %s, \"graph\": \"%s\", \"replies\": {%s}}\n", links,
              found.empty() ? "null" : found.c_str(), graph.c_str(), replies.c_str());
  std::fflush(stdout);
  std::_Exit(found.empty());
}
