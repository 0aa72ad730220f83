// Fast DDS as the robot's wire: what comes on standard input is published, what is heard
// goes to standard output. `fastdds_wire DOMAIN TOPIC PREFIX`, driven by
// tests/sensors/ros_robot.py. Messages are bytes made elsewhere (CDR, little-endian).
//
// Debian: libfastrtps-dev; g++ -std=c++17 fastdds_wire.cpp -lfastrtps -lfastcdr -o wire
//
// A record is a letter, four bytes of length (little-endian) and the bytes. In: I an
// image, C a command. Out: b a belief, d a decision, a an answer, m how many publish
// beliefs (four bytes).
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <mutex>
#include <string>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastrtps/utils/IPLocator.h>

namespace fast = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using Bytes = std::vector<uint8_t>;

// A type of that name whose values are bytes made elsewhere.
class BytesType : public fast::TopicDataType {
public:
    explicit BytesType(const std::string& name) {
        setName(name.c_str());
        m_typeSize = 1 << 20;
        m_isGetKeyDefined = false;
    }
    bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
        const Bytes& bytes = *static_cast<Bytes*>(data);
        if (bytes.size() > payload->max_size) return false;
        std::memcpy(payload->data, bytes.data(), bytes.size());
        payload->length = static_cast<uint32_t>(bytes.size());
        payload->encapsulation = CDR_LE;
        return true;
    }
    bool deserialize(rtps::SerializedPayload_t* payload, void* data) override {
        static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
        return [data] { return uint32_t(static_cast<Bytes*>(data)->size()); };
    }
    void* createData() override { return new Bytes(); }
    void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
    bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }
};

void write_out(char letter, const void* bytes, uint32_t length) {
    static std::mutex one;
    std::lock_guard<std::mutex> lock(one);
    std::fputc(letter, stdout);
    std::fwrite(&length, 4, 1, stdout);
    std::fwrite(bytes, 1, length, stdout);
    std::fflush(stdout);
}

class Ear : public fast::DataReaderListener {
public:
    explicit Ear(char letter) : letter_(letter) {}
    void on_data_available(fast::DataReader* reader) override {
        Bytes bytes;
        fast::SampleInfo about;
        while (reader->take_next_sample(&bytes, &about) == ReturnCode_t::RETCODE_OK)
            if (about.valid_data) write_out(letter_, bytes.data(), uint32_t(bytes.size()));
    }
    void on_subscription_matched(fast::DataReader*,
                                 const fast::SubscriptionMatchedStatus& status) override {
        if (letter_ == 'b') write_out('m', &status.current_count, 4);
    }

private:
    char letter_;
};

int main(int argc, char** argv) {
    if (argc != 4) return 2;
    const int domain = std::stoi(argv[1]);
    fast::DomainParticipantQos whole;
    for (int number = 0; number < 10; ++number) {  // on this machine, without multicast
        rtps::Locator_t peer;
        rtps::IPLocator::setIPv4(peer, 127, 0, 0, 1);
        peer.port = uint32_t(7400 + 250 * domain + 10 + 2 * number);
        whole.wire_protocol().builtin.initialPeersList.push_back(peer);
    }
    auto* participant =
        fast::DomainParticipantFactory::get_instance()->create_participant(domain, whole);
    if (participant == nullptr) return 1;
    const std::string image = "sensor_msgs::msg::dds_::Image_";
    const std::string text = "std_msgs::msg::dds_::String_";
    const std::string belief = "vision_msgs::msg::dds_::Classification_";
    for (const auto& name : {image, text, belief})
        fast::TypeSupport(new BytesType(name)).register_type(participant);
    auto topic = [&](const std::string& name, const std::string& type) {
        return participant->create_topic("rt" + name, type, fast::TOPIC_QOS_DEFAULT);
    };
    const std::string prefix = argv[3];
    auto* publisher = participant->create_publisher(fast::PUBLISHER_QOS_DEFAULT);
    auto* subscriber = participant->create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT);
    fast::DataWriterQos sent;
    sent.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    sent.publish_mode().kind = fast::ASYNCHRONOUS_PUBLISH_MODE;
    sent.history().depth = 10;
    auto* commands = publisher->create_datawriter(topic(prefix + "/command", text), sent);
    sent.reliability().kind = fast::BEST_EFFORT_RELIABILITY_QOS;  // as drivers of cameras
    auto* images = publisher->create_datawriter(topic(argv[2], image), sent);
    fast::DataReaderQos heard;
    heard.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    heard.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
    heard.history().depth = 64;
    Ear beliefs('b'), decisions('d'), answers('a');
    subscriber->create_datareader(topic(prefix + "/belief", belief), heard, &beliefs);
    subscriber->create_datareader(topic(prefix + "/decision", text), heard, &decisions);
    subscriber->create_datareader(topic(prefix + "/answer", text), heard, &answers);
    for (int letter; (letter = std::fgetc(stdin)) != EOF;) {
        uint32_t length = 0;
        if (std::fread(&length, 4, 1, stdin) != 1) break;
        Bytes bytes(length);
        if (std::fread(bytes.data(), 1, length, stdin) != length) break;
        (letter == 'I' ? images : commands)->write(&bytes);
    }
    std::_Exit(0);  // what is on its way does not matter
}
